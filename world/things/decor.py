"""What lies and stands about in a living room."""

import numpy as np

from ..looks import VIVID, Color, Split, Wardrobe, color, plain, shaded
from ..meshes import Mesh, box, cylinder, extrude, joined, lathe, pillow, ring, rounded, solid, sphere, sweep
from ..thing import Thing, build

Rng = np.random.Generator
PAPER = (0.93, 0.90, 0.82)
INK = (0.06, 0.06, 0.07)


def book(rng: Rng, split: Split) -> Thing:
    """Lying or standing; the spine towards -y, or +x when it stands."""
    wide, tall, thick = rng.uniform(0.13, 0.18), rng.uniform(0.19, 0.25), rng.uniform(0.018, 0.045)
    shade, cover = color(rng), 0.003
    print_ = plain("paper", (0.95, 0.93, 0.85) if min(shade.rgb) < 0.6 else shaded(shade.rgb, 0.35))
    boards = [box((tall, wide, cover)).moved(z=z) for z in (0, thick - cover)]
    spine = box((tall, cover, thick)).moved(y=-wide / 2 + cover / 2)
    pages = box((tall - 0.008, wide - 0.010, thick - 2 * cover)).moved(y=0.001, z=cover)
    title = [
        box((tall * a, wide * b, 0.0006)).moved(tall * x, 0, thick)
        for a, b, x in ((0.10, 0.68, 0.22), (0.05, 0.45, 0.08))
    ]
    band = [box((tall * 0.03, 0.0006, thick * 0.999)).moved(x=tall * x, y=-wide / 2 - 0.0002) for x in (-0.36, 0.36)]
    return build(
        "book", shade, "paper",
        (plain("paper", shade), *boards, spine), (plain("paper", PAPER), pages), (print_, *title, *band),
        turns=(("y", -90), ("z", 90)) if rng.random() < 0.45 else (),
    )  # fmt: skip


def lamp(rng: Rng, split: Split) -> Thing:
    """A table lamp; its colour is the shade's."""
    height, wide = rng.uniform(0.34, 0.52), rng.uniform(0.10, 0.14)
    shade = color(rng, *VIVID, "white", "grey")
    top, drop = wide * rng.uniform(0.5, 0.8), height * rng.uniform(0.36, 0.44)
    base_shade = color(rng, "black", "white", "brown", "grey")
    foot = solid(rounded([(wide * 0.62, 0), (wide * 0.62, 0.014), (0.02, 0.022)]))
    if rng.random() < 0.5:
        stem = sweep([(0, 0, 0.015), (0, 0, height - drop * 0.5)], 0.009)
    else:
        up = height - drop
        belly = rounded([(0.03, 0.015), (wide * 0.62, up * 0.35), (0.02, up * 0.85), (0.012, up + drop * 0.4)])
        stem = lathe([(0, 0.015), *belly, (0, up + drop * 0.4)])
    low = height - drop
    shell = ring([(wide, low), (top, height), (top - 0.003, height), (wide - 0.003, low)], 48)
    bulb = sphere(0.03).moved(z=height - drop * 0.5)
    cloth = Wardrobe(split, rng).cloth(Color(shade.word, shaded(shade.rgb, 1.1)), metres=0.1)
    return build(
        "lamp", shade, "fabric",
        (plain("ceramic", base_shade), foot, stem), (cloth, shell), (plain("glass", (0.96, 0.93, 0.80)), bulb),
    )  # fmt: skip


def vase(rng: Rng, split: Split) -> Thing:
    height, radius = rng.uniform(0.2, 0.34), rng.uniform(0.055, 0.085)
    neck, lip = radius * rng.uniform(0.3, 0.5), radius * rng.uniform(0.6, 0.9)
    low = rng.uniform(0.3, 0.6)
    shade, clothes = color(rng), Wardrobe(split, rng)
    outer = rounded(
        [(radius * 0.5, 0), (radius * 0.55, 0.005), (radius * 1.15, height * low), (radius * 0.9, height * (low + 0.2)),
         (neck, height * 0.86), (neck, height * 0.9), (lip, height)], 3,
    )  # fmt: skip
    inner = [(max(r - 0.004, 0.002), max(z, 0.01)) for r, z in outer[::-1]]
    look = clothes.maybe_patterned(shade, "ceramic", 0.11, 0.45)
    return build("vase", shade, "ceramic", (look, solid([*outer, *inner])))


def plant(rng: Rng, split: Split) -> Thing:
    """A pot plant; it is green, whatever its pot."""
    big = rng.random() < 0.4
    scale = rng.uniform(1.8, 2.6) if big else rng.uniform(0.8, 1.2)
    pot_shade, green = color(rng, "brown", "white", "grey", "orange", "blue"), color(rng, "green")
    pot = solid([(0.045, 0), (0.06, 0.10), (0.066, 0.10), (0.066, 0.12), (0.057, 0.12), (0.055, 0.105)])
    soil = cylinder(0.056, 0.004).moved(z=0.104)
    count, long, wide = (int(rng.integers(14, 22)), rng.uniform(0.16, 0.24), rng.uniform(0.035, 0.065))
    leaves = []
    for k in range(count):
        steep = 0.25 + 1.5 * (k / count) ** 1.2
        leaf = _blade(long * rng.uniform(0.75, 1.05), wide, steep, rng.uniform(0.3, 0.8))
        leaves.append(leaf.turned("z", 137.5 * k + rng.uniform(-15, 15)).moved(z=0.105))
    return build(
        "plant", green, "leaf",
        (plain("ceramic", pot_shade), pot), (plain("paper", (0.16, 0.10, 0.07)), soil),
        (plain("leaf", green), *leaves[::2]), (plain("leaf", shaded(green.rgb, 0.72)), *leaves[1::2]),
        scale=scale,
    )  # fmt: skip


def _blade(length: float, width: float, steep: float, droop: float) -> Mesh:
    """A leaf of this length from the origin along +x, rising steeply and bending down."""
    t = np.linspace(0, 1, 12)
    angle = np.arctan(steep) - droop * 1.6 * t
    steps = np.stack([np.cos(angle), 0 * t, np.sin(angle)], axis=1) * length / 11
    path = np.cumsum(steps, axis=0) - steps[0]
    half = [(0.0012, max(0.002, width / 2 * np.sin(np.pi * np.clip(s**0.8, 0.0, 0.98)))) for s in t]
    return sweep(path, half, 10)


def candle(rng: Rng, split: Split) -> Thing:
    """A pillar candle on a saucer, alight."""
    radius, height = rng.uniform(0.022, 0.034), rng.uniform(0.09, 0.17)
    shade = color(rng, *VIVID, "white", "white")
    top = rounded([(radius, height), (radius * 0.9, height + 0.004), (radius * 0.7, height - 0.003)])
    wax = lathe([(0, 0.008), (radius, 0.008), *top, (0, height - 0.004)])
    bends = [(1.2, 0), (1.9, 0.012), (1.85, 0.016), (1.2, 0.009)]
    saucer = solid(rounded([(radius * share, z) for share, z in bends]))
    wick = sweep([(0, 0, height - 0.006), (0, 0, height + 0.010)], 0.0014, 8)
    drop = [(0.0, 0), (0.006, 0.004), (0.0085, 0.011), (0.004, 0.024), (0.0, 0.036)]
    flame = lathe(rounded(drop)).moved(z=height + 0.006)
    return build(
        "candle", shade, "wax",
        (plain("wax", shade), wax), (plain("ceramic", color(rng, "grey", "white", "black", "brown")), saucer),
        (plain("paper", INK), wick), (plain("flame", (1.0, 0.72, 0.22)), flame),
    )  # fmt: skip


def clock(rng: Rng, split: Split) -> Thing:
    """A round alarm clock on two feet; its face is towards +x."""
    radius, deep = rng.uniform(0.055, 0.09), rng.uniform(0.03, 0.05)
    shade = color(rng, *VIVID, "black", "brown", "grey")
    wall = [(0.9, 0), (1, 0.004), (1, deep - 0.003), (0.96, deep), (0.88, deep - 0.002)]
    case = solid([*rounded([(radius * share, z) for share, z in wall]), (radius * 0.87, deep - 0.007)], 56)
    face = cylinder(radius * 0.875, 0.003, 0, 48).moved(z=deep - 0.008)
    ticks = [
        box((radius * (0.2 if k % 3 == 0 else 0.12), radius * 0.05, 0.0012))
        .moved(x=radius * 0.72).turned("z", 30 * k).moved(z=deep - 0.0052)
        for k in range(12)
    ]  # fmt: skip
    hour, minute = rng.uniform(0, 360, 2)
    hands = [
        box((radius * long, radius * wide, 0.0015))
        .moved(x=radius * long * 0.42).turned("z", turn).moved(z=deep - 0.0045)
        for long, wide, turn in ((0.5, 0.075, hour), (0.7, 0.05, minute))
    ]  # fmt: skip
    hub = cylinder(radius * 0.06, 0.004).moved(z=deep - 0.005)
    metal = []
    for s in (1, -1):
        foot = [(s * radius * 0.45, -radius * 0.8, deep / 2), (s * radius * 0.75, -radius * 1.16, deep / 2)]
        metal.append(sweep(foot, radius * 0.09))
    if rng.random() < 0.55:
        bell = sphere(radius * 0.34, radius * 0.34, radius * 0.22, 24)
        for s in (1, -1):
            metal.append(bell.turned("x", 90).turned("z", s * -32).moved(s * radius * 0.58, radius * 0.98, deep / 2))
        turns = np.radians(np.linspace(10, 170, 14))
        arch = [(radius * 0.36 * np.cos(a), radius * (1.15 + 0.34 * np.sin(a)), deep / 2) for a in turns]
        metal.append(sweep(arch, radius * 0.045))
    return build(
        "clock", shade, "plastic",
        (plain("plastic", shade), case), (plain("paper", (0.95, 0.94, 0.90)), face),
        (plain("paper", INK), *ticks, *hands, hub), (plain("plastic", shaded(shade.rgb, 0.6)), *metal),
        turns=(("x", 90), ("z", 90)),
    )  # fmt: skip


def laptop(rng: Rng, split: Split) -> Thing:
    """Open, its screen towards +x."""
    wide, deep = rng.uniform(0.30, 0.36), rng.uniform(0.21, 0.25)
    shade, open_ = (color(rng, "grey", "grey", "black", "white", "pink", "blue"), rng.uniform(100, 120))
    base = box((deep, wide, 0.016), 0.004)
    keys = [
        box((0.0125, wide * 0.068, 0.0016), 0).moved(x, y, 0.016)
        for x in -deep / 2 + 0.045 + 0.0165 * np.arange(5)
        for y in wide * 0.076 * (np.arange(12) - 5.5)
    ]
    pad = box((deep * 0.27, wide * 0.32, 0.0008)).moved(deep * 0.32, 0, 0.016)
    lid = box((0.009, wide, deep), 0.004).moved(x=-0.0045)
    bezel = box((0.001, wide * 0.97, deep * 0.95)).moved(x=0.0004, z=deep * 0.03)
    screen = box((0.001, wide * 0.93, deep * 0.86)).moved(x=0.0009, z=deep * 0.075)
    window = box((0.001, wide * 0.46, deep * 0.46)).moved(x=0.0014, y=wide * rng.uniform(-0.18, 0.18), z=deep * 0.25)
    hinged = [mesh.turned("y", 90 - open_).moved(-deep / 2 + 0.008, 0, 0.012) for mesh in (lid, bezel, screen, window)]
    return build(
        "laptop", shade, "plastic",
        (plain("plastic", shade), base, hinged[0]), (plain("plastic", (0.07, 0.07, 0.08)), *keys, hinged[1]),
        (plain("plastic", shaded(shade.rgb, 0.8)), pad),
        (plain("screen", color(rng, "blue", "green", "purple", "orange")), hinged[2]),
        (plain("screen", (0.92, 0.93, 0.95)), hinged[3]),
    )  # fmt: skip


def cushion(rng: Rng, split: Split) -> Thing:
    side, thick = rng.uniform(0.36, 0.46), rng.uniform(0.13, 0.18)
    shade, clothes = color(rng), Wardrobe(split, rng)
    look = clothes.patterned(shade, "fabric", 0.2) if rng.random() < 0.5 else clothes.cloth(shade)
    return build("cushion", shade, "fabric", (look, pillow(side, side * rng.uniform(0.7, 1.0), thick)))


def carton(rng: Rng, split: Split) -> Thing:
    """A gift box with a lid and a ribbon, or a cardboard box with open flaps."""
    x, y, z = rng.uniform(0.14, 0.26), rng.uniform(0.14, 0.26), rng.uniform(0.10, 0.2)
    if rng.random() < 0.45:
        return _open_box(rng, x * 1.3, y * 1.3, z * 1.2)
    shade = color(rng)
    look = Wardrobe(split, rng).maybe_patterned(shade, "cardboard", 0.12, 0.3)
    body, lid = box((x, y, z), 0.003), box((x + 0.01, y + 0.01, z * 0.24), 0.003).moved(z=z * 0.82)
    band_shade = color(rng, *(word for word in ("red", "yellow", "white", "blue") if word != shade.word))
    across = [box((0.022, y + 0.013, z * 1.065)), box((x + 0.013, 0.022, z * 1.065))]
    turns = np.radians(np.linspace(0, 360, 18, endpoint=False))
    loops = [
        sweep(
            [(s * (0.034 + 0.032 * np.cos(a)), 0, z * 1.065 + 0.016 + 0.017 * np.sin(a)) for a in turns],
            [(0.002, 0.012)] * 18, 8, 4, loop=True,
        )
        for s in (1, -1)
    ]  # fmt: skip
    bow = (*loops, sphere(0.012).moved(z=z * 1.065 + 0.01))
    return build("box", shade, "cardboard", (look, body, lid), (plain("fabric", band_shade), *across, *bow))


def _open_box(rng: Rng, x: float, y: float, z: float) -> Thing:
    shade = Color("brown", shaded(color(rng, "brown").rgb, 1.28))
    look, wall = plain("cardboard", shade), 0.005
    walls = [box((x, wall, z)).moved(y=s * (y - wall) / 2) for s in (1, -1)]
    walls += [box((wall, y - 2 * wall, z)).moved(x=s * (x - wall) / 2) for s in (1, -1)]
    flaps = []
    for turn, across, half in ((0, y, x), (90, x, y), (180, y, x), (270, x, y)):
        flap = box((half * 0.42, across * 0.96, 0.004)).moved(x=half * 0.21).turned("y", rng.uniform(10, 50))
        flaps.append(flap.moved(x=half / 2 - wall, z=z).turned("z", turn))
    tape = box((0.001, 0.045, z * 0.55)).moved(x=x / 2, z=z * 0.45)
    return build(
        "box", shade, "cardboard", (look, box((x, y, wall)), *walls, *flaps),
        (plain("paper", (0.80, 0.70, 0.5)), tape),
    )  # fmt: skip


def basket(rng: Rng, split: Split) -> Thing:
    """Wicker, with a handle over it."""
    radius, height = rng.uniform(0.12, 0.17), rng.uniform(0.12, 0.18)
    shade = Color("brown", shaded(color(rng, "brown").rgb, 1.25))
    look = Wardrobe(split, rng).textured("wicker", "wicker", shaded(shade.rgb, 1.25), shaded(shade.rgb, 0.4), 0.16)
    foot = radius * rng.uniform(0.72, 0.85)
    body = solid([(foot, 0), (radius, height), (radius - 0.008, height), (foot - 0.008, 0.01)])
    turns = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rim = sweep([(radius * 0.98 * np.cos(a), radius * 0.98 * np.sin(a), height) for a in turns], 0.009, loop=True)
    arch = np.linspace(0, np.pi, 24)
    over = rng.uniform(0.8, 1.2) * radius
    handle = sweep([(0, radius * 0.97 * np.cos(a), height + over * np.sin(a)) for a in arch], 0.008)
    return build("basket", shade, "wicker", (look, body), (plain("wicker", shaded(shade.rgb, 0.8)), rim, handle))


def frame(rng: Rng, split: Split) -> Thing:
    """A picture in a frame, leaning back on its stand, towards +x: hills under a sky."""
    wide, tall, rim = rng.uniform(0.14, 0.2), rng.uniform(0.17, 0.24), rng.uniform(0.015, 0.024)
    shade = color(rng)
    bars = [box((0.016, wide, rim)), box((0.016, wide, rim)).moved(z=tall - rim)]
    bars += [box((0.016, rim, tall)).moved(y=s * (wide - rim) / 2) for s in (1, -1)]
    sky = box((0.006, wide - rim, tall - rim)).moved(z=rim / 2)
    half = wide / 2 - rim
    ridge = [
        (y, rim + (tall - 2 * rim) * h)
        for y, h in zip(
            np.linspace(half, -half, 9).tolist(),
            (0.42 + 0.14 * np.sin(np.arange(9) * rng.uniform(0.6, 1.3))).tolist(),
            strict=True,
        )
    ]
    hills = extrude([(-half, rim), (half, rim), *ridge], 0.0012).turned("x", 90).turned("z", 90).moved(x=0.0032)
    sun = cylinder(0.016, 0.001).turned("y", 90).moved(0.0032, half * 0.4, tall * 0.74)
    pieces = [
        (plain("plastic", shade), joined(*bars)), (plain("paper", (0.62, 0.80, 0.93)), sky),
        (plain("paper", (0.33, 0.55, 0.28)), hills), (plain("paper", (0.98, 0.82, 0.35)), sun),
    ]  # fmt: skip
    leaning = [(look, mesh.turned("y", -12)) for look, mesh in pieces]
    prop = sweep([(-0.004, 0, tall * 0.55), (-tall * 0.38, 0, 0.003)], [(0.003, 0.012)] * 2, 8, 5)
    return build(
        "picture", shade, "plastic", *leaning, (plain("cardboard", (0.2, 0.18, 0.17)), prop.moved(x=-tall * 0.1))
    )


THINGS = (book, lamp, vase, plant, candle, clock, laptop, cushion, carton, basket, frame)
