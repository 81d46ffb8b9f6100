"""What stands on a kitchen table."""

from collections.abc import Sequence

import numpy as np

from ..looks import VIVID, Color, Look, Split, Wardrobe, color, plain, shaded
from ..meshes import Curve, Mesh, Vec3, cylinder, extrude, lathe, ring, rounded, solid, sphere, sweep
from ..thing import Thing, build

Rng = np.random.Generator
STEEL = Color("grey", (0.62, 0.62, 0.64))


def _vessel(outer: Curve, wall: float, floor: float) -> Mesh:
    """An open pot: up the outer profile, over a round rim, down inside it."""
    inner = [(max(r - wall, 0.001), max(z, floor)) for r, z in outer[::-1] if z > 0.3 * floor]
    (r, z), rim = outer[-1], wall / 2
    return lathe([(0, 0), *outer, (r - 0.2 * wall, z + rim), (r - 0.8 * wall, z + rim), *inner, (0, floor)])


def _band(inner: float, outer: float, low: float, high: float) -> Mesh:
    """A square ring."""
    return ring([(inner, low), (outer, low), (outer, high), (inner, high)])


def _arc(center: tuple[float, float], radii: tuple[float, float], start: float, end: float) -> list[Vec3]:
    """In the yz plane; degrees from +y towards +z."""
    turns = np.radians(np.linspace(start, end, 14))
    return [(0, center[0] + radii[0] * np.cos(a), center[1] + radii[1] * np.sin(a)) for a in turns]


def mug(rng: Rng, split: Split) -> Thing:
    radius, height = rng.uniform(0.036, 0.046), rng.uniform(0.085, 0.115)
    foot, bulge = radius * rng.uniform(0.75, 1.0), rng.uniform(0.97, 1.06)
    shade, clothes = color(rng), Wardrobe(split, rng)
    outer = rounded([(foot * 0.9, 0), (foot, 0.002), (radius * bulge, height * 0.4), (radius, height)])
    look = clothes.maybe_patterned(shade, "ceramic", 0.07, 0.35)
    grip = rng.uniform(0.026, 0.034)
    handle = _arc((radius * 0.96, height * 0.52), (grip, height * rng.uniform(0.28, 0.36)), -88, 88)
    wall = 0.004
    drink = plain("ceramic", (0.20, 0.11, 0.06))
    pieces = [
        (look, _vessel(outer, wall, 0.008)),
        (plain("ceramic", shade), sweep(handle, [(0.0055, 0.0085)] * len(handle))),
    ]
    if rng.random() < 0.4:
        pieces.append((drink, cylinder(radius - wall, 0.002).moved(z=height * 0.8)))
    return build("mug", shade, "ceramic", *pieces)


def bowl(rng: Rng, split: Split) -> Thing:
    radius = rng.uniform(0.065, 0.12)
    height, foot = radius * rng.uniform(0.55, 0.8), radius * rng.uniform(0.42, 0.55)
    shade, clothes = color(rng), Wardrobe(split, rng)
    material = str(rng.choice(["ceramic", "ceramic", "plastic"]))
    outer = rounded(
        [(foot, 0), (foot, 0.006), (radius * 0.82, height * 0.35), (radius, height * 0.75), (radius, height)]
    )
    look = clothes.maybe_patterned(shade, material, 0.09, 0.35)
    return build("bowl", shade, material, (look, _vessel(outer, 0.005, 0.01)))


def plate(rng: Rng, split: Split) -> Thing:
    radius = rng.uniform(0.10, 0.14)
    lift, flat = rng.uniform(0.014, 0.022), radius * rng.uniform(0.6, 0.7)
    shade, clothes = color(rng), Wardrobe(split, rng)
    top = [(flat, 0.006), (flat + 0.012, lift * 0.8), (radius, lift + 0.004)]
    under = [(flat * 0.9, 0), (flat, 0.001), (radius - 0.002, lift - 0.001), (radius, lift + 0.001)]
    dish = solid([*rounded(under, 1), *rounded(top, 1)[::-1]], 56)
    band = plain("ceramic", shaded(shade.rgb, 0.6 if min(shade.rgb) > 0.3 else 1.5))
    a, b = radius * 0.90, radius * 0.95
    slope = (lift + 0.004 - lift * 0.8) / (radius - flat - 0.012)

    def rim(r: float) -> float:
        return lift * 0.8 + slope * (r - flat - 0.012)

    edge = ring([(a, rim(a) - 0.002), (b, rim(b) - 0.002), (b, rim(b) + 0.0007), (a, rim(a) + 0.0007)], 56)
    look = clothes.maybe_patterned(shade, "ceramic", 0.12, 0.15)
    return build("plate", shade, "ceramic", (look, dish), (band, edge))


def bottle(rng: Rng, split: Split) -> Thing:
    radius, height = rng.uniform(0.033, 0.042), rng.uniform(0.23, 0.32)
    neck, shoulder = radius * rng.uniform(0.34, 0.45), height * rng.uniform(0.52, 0.64)
    shade = color(rng, *VIVID, "brown", "black", "white")
    profile = [
        (radius * 0.9, 0), (radius, 0.004), (radius, shoulder), (radius, shoulder + 0.02),
        (neck, shoulder + height * rng.uniform(0.16, 0.22)), (neck, height * 0.94), (neck, height * 0.95),
    ]  # fmt: skip
    body = solid(rounded(profile))
    low, high = height * 0.12, shoulder * rng.uniform(0.7, 0.9)
    r = radius + 0.0006
    labels = [
        (plain("paper", (0.93, 0.92, 0.86)), _band(radius * 0.9, r, low, high)),
        (plain("paper", color(rng, *VIVID)), _band(radius * 0.9, r + 0.0004, low + 0.02, high - 0.03)),
    ]
    cap = cylinder(neck * 1.25, height * 0.08, 0.002).moved(z=height * 0.92)
    pieces = [(plain("glass", shade), body), (plain("plastic", color(rng, "black", "white", "red")), cap)]
    if rng.random() < 0.6:
        pieces += labels if rng.random() < 0.5 else labels[:1]
    return build("bottle", shade, "glass", *pieces)


def teapot(rng: Rng, split: Split) -> Thing:
    radius, squash = rng.uniform(0.07, 0.09), rng.uniform(0.75, 1.0)
    height = 1.5 * radius * squash
    shade, clothes = color(rng), Wardrobe(split, rng)
    belly = [
        (radius * 0.55, 0), (radius * 0.6, 0.005), (radius * 1.05, height * 0.32),
        (radius * 1.02, height * 0.75), (radius * 0.5, height), (radius * 0.42, height),
    ]  # fmt: skip
    body = solid(rounded(belly))
    cover = rounded([(radius * 0.5, 0.004), (radius * 0.42, 0.02), (radius * 0.1, 0.026)])
    lid = lathe([(0, 0), (radius * 0.5, 0), *cover, (0, 0.027)])
    knob = sphere(radius * 0.15).moved(z=height + 0.027 + radius * 0.1)
    spout = rounded([(0.75, 0.25), (1.15, 0.35), (1.4, 0.65), (1.68, 0.95)])
    pipe = [(radius * x, 0.0, height * z) for x, z in spout]
    tube = sweep(pipe, np.linspace(radius * 0.28, radius * 0.11, len(pipe)))
    grip = np.radians(np.linspace(80, 280, 16))
    reach = radius * rng.uniform(0.55, 0.7)
    path = [(-radius * 0.88 + reach * np.cos(a), 0, height * 0.55 + height * 0.38 * np.sin(a)) for a in grip]
    handle = sweep(path, radius * 0.095)
    look = clothes.maybe_patterned(shade, "ceramic", 0.12, 0.35)
    rest = (plain("ceramic", shade), lid.moved(z=height - 0.001), knob, tube, handle)
    return build("teapot", shade, "ceramic", (look, body), rest)


def _cutlery_shade(rng: Rng) -> tuple[Color, str, Look]:
    kind = rng.integers(4)
    if kind == 0:
        shade = color(rng, *VIVID)
        return shade, "plastic", plain("plastic", shade)
    if kind == 1:
        shade = color(rng, "brown")
        return shade, "wood", plain("wood", shaded(shade.rgb, 1.2))
    return STEEL, "metal", plain("metal", STEEL)


def _ribbon(path: Sequence[Vec3], widths: list[float], thick: float, square: float = 4.0) -> Mesh:
    return sweep(path, [(w / 2, thick / 2) for w in widths], 16, square)


def spoon(rng: Rng, split: Split) -> Thing:
    length, scoop = rng.uniform(0.16, 0.23), rng.uniform(0.028, 0.036)
    shade, material, look = _cutlery_shade(rng)
    wide = scoop * rng.uniform(0.62, 0.75)
    dish = rounded([(0.02, -0.4), (0.6, -0.35), (1, 0.0)])
    inner = [(r * 0.93, z + 0.13) for r, z in dish[::-1]]
    cup = lathe([(0, -0.4), *dish, *inner, (0, -0.27)]).scaled(scoop, wide, 0.019)
    t = np.linspace(0, 1, 12)
    path = [(-scoop * 0.9 - s * (length - 2 * scoop), 0, 0.010 * np.sin(np.pi * s * 0.9) - 0.004 * s) for s in t]
    widths = [0.007 + 0.010 * float(np.clip((s - 0.45) / 0.5, 0, 1)) for s in t]
    handle = _ribbon(path, widths, 0.0045 if material == "wood" else 0.003)
    return build("spoon", shade, material, (look, cup, handle))


def fork(rng: Rng, split: Split) -> Thing:
    length, tine = rng.uniform(0.17, 0.20), rng.uniform(0.042, 0.052)
    shade, material, look = _cutlery_shade(rng)
    count, wide = int(rng.integers(3, 5)), rng.uniform(0.026, 0.031)
    t = np.linspace(0, 1, 12)
    path = [(-s * (length - tine - 0.022), 0, 0.012 * np.sin(np.pi * s * 0.85)) for s in t]
    widths = [0.007 + 0.011 * float(np.clip((s - 0.4) / 0.5, 0, 1)) for s in t]
    handle = _ribbon(path, widths, 0.003)
    root = _ribbon(
        [(-0.002 + 0.027 * s, 0, -0.001 * s) for s in t], [0.008 + (wide - 0.008) * min(1.0, 1.8 * s) for s in t], 0.003
    )
    lanes = np.linspace(-1, 1, count) * (wide / 2 - 0.0024)
    u = np.linspace(0, 1, 7)
    tines = [
        _ribbon(
            [(0.023 + s * tine, y, -0.001 - 0.004 * np.sin(np.pi * s) + 0.006 * s * s) for s in u],
            [0.0046 - 0.002 * s for s in u],
            0.0028,
        )
        for y in lanes
    ]
    return build("fork", shade, material, (look, handle, root, *tines))


def knife(rng: Rng, split: Split) -> Thing:
    """Blade towards +x, lying on its side."""
    blade, grip, wide = rng.uniform(0.11, 0.17), rng.uniform(0.09, 0.115), rng.uniform(0.024, 0.036)
    shade = color(rng, "black", "brown", "red", "blue", "white", "green")
    material = "wood" if shade.word == "brown" else "plastic"
    edge = rounded([(0, -wide / 2), (blade * 0.75, -wide / 2), (blade, wide * 0.28)])
    outline = [*edge, (blade, wide / 2 - 0.004), (blade * 0.9, wide / 2), (0, wide / 2)]
    steel = extrude(outline, 0.0022).moved(z=0.006)
    t = np.linspace(0, 1, 10)
    path = [(0.004 - grip * s, 0, 0.007) for s in t]
    half = [(0.007, wide * (0.40 + 0.06 * np.cos(2 * np.pi * s))) for s in t]
    handle = sweep(path, half, 16, 3.5)
    rivets = [cylinder(0.003, 0.0162).moved(-grip * s, 0, -0.0008) for s in (0.25, 0.7)]
    return build("knife", shade, material, (plain(material, shade), handle), (plain("metal", STEEL), steel, *rivets))


def pot(rng: Rng, split: Split) -> Thing:
    """A cooking pot with a lid and two handles."""
    radius = rng.uniform(0.09, 0.13)
    height = radius * rng.uniform(0.95, 1.35)
    steel = rng.random() < 0.4
    shade = STEEL if steel else color(rng, "red", "orange", "green", "blue", "black", "white")
    material = "metal" if steel else "ceramic"
    look, dark = plain(material, shade), plain("plastic", (0.09, 0.09, 0.1))
    body = cylinder(radius, height, 0.012)
    rim = _band(radius * 0.9, radius + 0.004, height - 0.006, height + 0.002)
    cover = rounded([(radius + 0.002, 0.004), (radius * 0.8, 0.022), (radius * 0.1, 0.03)])
    lid = solid([(radius + 0.002, 0), *cover])
    knob = solid([(0.007, 0), (0.007, 0.014), *rounded([(0.018, 0.016), (0.02, 0.026), (0.012, 0.032)])])
    arc = _arc((radius * 0.97, 0), (0.035, 0.035), -90, 90)
    ear = sweep([(z, y, height * 0.78) for _, y, z in arc], 0.0065)
    return build(
        "pot", shade, material,
        (look, body, rim, lid.moved(z=height + 0.001)),
        (dark, knob.moved(z=height + 0.029), ear, ear.turned("z", 180)),
    )  # fmt: skip


def pan(rng: Rng, split: Split) -> Thing:
    """A frying pan; the handle towards +x."""
    radius, height = rng.uniform(0.10, 0.135), rng.uniform(0.035, 0.05)
    shade = color(rng, "black", "black", "grey", "red", "blue", "green")
    outer = rounded([(radius * 0.78, 0), (radius * 0.82, 0.002), (radius, height)])
    dish = _vessel(outer, 0.005, 0.005)
    length = rng.uniform(0.15, 0.2)
    t = np.linspace(0, 1, 10)
    path = [(radius * 0.97 + length * s, 0, height * 0.75 + 0.03 * s) for s in t]
    handle = sweep(path, [(0.006 + 0.003 * s, 0.008 + 0.006 * s) for s in t], 16, 3.0)
    inside = solid([(radius * 0.78, 0.0058), (radius * 0.8, 0.0075)])
    grip = plain("wood", color(rng, "brown")) if rng.random() < 0.4 else plain("plastic", (0.08, 0.08, 0.09))
    return build(
        "pan", shade, "metal",
        (plain("ceramic", shade), dish), (plain("ceramic", (0.14, 0.14, 0.15)), inside), (grip, handle),
    )  # fmt: skip


THINGS = (mug, bowl, plate, bottle, teapot, spoon, fork, knife, pot, pan)
