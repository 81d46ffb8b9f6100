"""Furniture; tables, shelves and seats have ledges for other things."""

import numpy as np

from ..looks import VIVID, Color, Look, Split, Wardrobe, color, plain, shaded
from ..meshes import Mesh, box, cylinder, joined, ring, rounded, solid, sweep
from ..thing import Ledge, Thing, build

Rng = np.random.Generator


def _timber(rng: Rng, split: Split) -> tuple[Color, Look]:
    """Brown wood with grain, or painted."""
    if rng.random() < 0.6:
        shade = color(rng, "brown")
        shade = Color("brown", shaded(shade.rgb, rng.uniform(0.9, 1.25)))
        return shade, Wardrobe(split, rng).wood(shade, 0.6)
    shade = color(rng, *VIVID, "white", "black", "grey")
    return shade, plain("wood", shade)


def _leg(x: float, y: float, z: float, thick: float, splay: float = 0.0, round_: bool = False) -> Mesh:
    path = [(x * (1 + splay), y * (1 + splay), 0), (x, y, z)]
    return sweep(path, [thick * 0.36, thick / 2], 14, 2 if round_ else 8)


def chair(rng: Rng, split: Split) -> Thing:
    wide, deep, seat, top = (rng.uniform(0.40, 0.46), rng.uniform(0.40, 0.45), 0.45, rng.uniform(0.84, 0.98))
    shade, look = _timber(rng, split)
    board = box((deep, wide, 0.03), 0.010).moved(z=seat - 0.03)
    x, y = deep / 2 - 0.035, wide / 2 - 0.035
    legs = [_leg(x, s * y, seat - 0.01, 0.042, 0.08) for s in (1, -1)]
    lean = rng.uniform(0.03, 0.08)
    posts = [
        sweep([(-x - 0.02, s * y, 0), (-x, s * y, seat), (-x - lean, s * y, top)], [0.016, 0.02, 0.015], 14, 6)
        for s in (1, -1)
    ]
    back = _slats(rng, x, y, seat, top, lean)
    rungs = [sweep([(-x, s * y, 0.2), (x * 1.04, s * y * 1.03, 0.2)], 0.010) for s in (1, -1)]
    pieces = [(look, joined(board, *legs, *posts, *back, *rungs))]
    if rng.random() < 0.35:
        pad = box((deep * 0.9, wide * 0.9, 0.035), 0.016).moved(0.01, 0, seat - 0.001)
        pieces.append((plain("fabric", color(rng, "white", "grey", shade.word)), pad))
    return build("chair", shade, "wood", *pieces)


def _slats(rng: Rng, x: float, y: float, seat: float, top: float, lean: float) -> list[Mesh]:
    rail = box((0.022, 2 * y + 0.03, 0.08), 0.008).moved(-x - lean * 0.92, 0, top - 0.075)
    if rng.random() < 0.5:
        slat, heights = box((0.016, 2 * y, 0.055), 0.006), np.linspace(0.35, 0.72, int(rng.integers(1, 3)))
        return [rail, *(slat.moved(-x - lean * h, 0, seat + h * (top - seat) - 0.03) for h in heights)]
    bars = np.linspace(-0.7, 0.7, int(rng.integers(3, 6))) * y
    return [rail, *(sweep([(-x, b, seat - 0.01), (-x - lean * 0.92, b, top - 0.05)], 0.009) for b in bars)]


def stool(rng: Rng, split: Split) -> Thing:
    radius, height, count = (rng.uniform(0.15, 0.19), rng.uniform(0.44, 0.66), int(rng.integers(3, 5)))
    shade, look = _timber(rng, split)
    thick = rng.uniform(0.03, 0.045)
    seat = cylinder(radius, thick, 0.010).moved(z=height - thick)
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count
    legs = [
        _leg(radius * 0.72 * np.cos(a), radius * 0.72 * np.sin(a), height - 0.02, 0.036, 0.42, True) for a in angles
    ]
    ring = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    low, reach = height * 0.33, radius * 0.72 * (1 + 0.42 * 0.67)
    hoop = sweep([(reach * np.cos(a), reach * np.sin(a), low) for a in ring], 0.008, loop=True)
    side = radius * 1.2
    return build("stool", shade, "wood", (look, seat, *legs, hoop), ledges=(Ledge(height, (0, 0), (side, side)),))


def table(rng: Rng, split: Split) -> Thing:
    """Square or round; a dining table, or a low one."""
    low = rng.random() < 0.35
    height = rng.uniform(0.40, 0.46) if low else rng.uniform(0.71, 0.76)
    long, wide = rng.uniform(1.1, 1.5), rng.uniform(0.75, 0.9)
    shade, look = _timber(rng, split)
    if rng.random() < 0.4:
        radius = rng.uniform(0.48, 0.6)
        top = cylinder(radius, 0.035, 0.008, 64).moved(z=height - 0.035)
        legs = [
            _leg(radius * 0.62 * np.cos(a), radius * 0.62 * np.sin(a), height - 0.02, 0.055, 0.12, True)
            for a in np.pi / 4 + np.pi / 2 * np.arange(4)
        ]
        ledge = Ledge(height, (0, 0), (radius * 1.4, radius * 1.4))
        return build("table", shade, "wood", (look, top, *legs), ledges=(ledge,))
    top = box((long, wide, 0.035), 0.006).moved(z=height - 0.035)
    x, y = long / 2 - 0.06, wide / 2 - 0.06
    legs = [_leg(sx * x, sy * y, height - 0.02, 0.065) for sx in (1, -1) for sy in (1, -1)]
    apron = [box((2 * x, 0.02, 0.07)).moved(0, s * y, height - 0.1) for s in (1, -1)]
    apron += [box((0.02, 2 * y, 0.07)).moved(s * x, 0, height - 0.1) for s in (1, -1)]
    ledge = Ledge(height, (0, 0), (long - 0.06, wide - 0.06))
    return build("table", shade, "wood", (look, top, *legs, *apron), ledges=(ledge,))


def sofa(rng: Rng, split: Split) -> Thing:
    wide, deep, seats = rng.uniform(1.45, 2.0), rng.uniform(0.78, 0.9), int(rng.integers(2, 4))
    shade, clothes = color(rng), Wardrobe(split, rng)
    leather = rng.random() < 0.3
    look = plain("leather", shade) if leather else clothes.cloth(shade, metres=0.25)
    arm, high = rng.uniform(0.14, 0.2), rng.uniform(0.56, 0.64)
    back_high = rng.uniform(0.76, 0.88)
    base = box((deep - 0.04, wide - 0.04, 0.20), 0.02).moved(z=0.10)
    back = box((0.18, wide - 0.04, back_high - 0.12), 0.05).moved(-deep / 2 + 0.09, 0, 0.12)
    arms = [box((deep, arm, high - 0.1), 0.055).moved(0, s * (wide - arm) / 2, 0.10) for s in (1, -1)]
    room = (wide - 2 * arm) / seats
    places = [(k - (seats - 1) / 2) * room for k in range(seats)]
    pads = [box((deep - 0.2, room - 0.012, 0.15), 0.05).moved(0.09, y, 0.29) for y in places]
    rests = [
        box((0.17, room - 0.014, back_high - 0.40), 0.065).turned("y", -9).moved(-deep / 2 + 0.29, y, 0.42)
        for y in places
    ]
    feet = [
        cylinder(0.025, 0.10).moved(sx * (deep / 2 - 0.08), sy * (wide / 2 - 0.08)) for sx in (1, -1) for sy in (1, -1)
    ]
    ledge = Ledge(0.44, (0.16, 0), (0.44, wide - 2 * arm - 0.08))
    return build(
        "sofa", shade, "leather" if leather else "fabric", (look, base, back, *arms, *pads, *rests),
        (plain("wood", (0.22, 0.14, 0.08)), *feet), ledges=(ledge,),
    )  # fmt: skip


def shelf(rng: Rng, split: Split) -> Thing:
    """An open bookcase, its back towards -x."""
    wide, deep, rows = rng.uniform(0.75, 1.0), rng.uniform(0.29, 0.35), int(rng.integers(3, 5))
    gap, thick = rng.uniform(0.33, 0.40), 0.025
    shade, look = _timber(rng, split)
    height = 0.06 + rows * gap + thick
    sides = [box((deep, thick, height), 0.002).moved(0, s * (wide - thick) / 2) for s in (1, -1)]
    levels = [0.06 + k * gap for k in range(rows + 1)]
    boards = [box((deep - 0.004, wide - 2 * thick, thick)).moved(z=z) for z in levels]
    back = box((0.008, wide - 2 * thick, height - 0.06)).moved(-deep / 2 + 0.006, 0, 0.06)
    ledges = [
        Ledge(z + thick, (0.01, 0), (deep - 0.06, wide - 2 * thick - 0.04), gap - thick - 0.02) for z in levels[:-1]
    ]
    top = Ledge(height, (0, 0), (deep - 0.06, wide - 0.08))
    back_look = plain("wood", shaded(shade.rgb, 0.85))
    return build("shelf", shade, "wood", (look, *sides, *boards), (back_look, back), ledges=(*ledges, top))


def floor_lamp(rng: Rng, split: Split) -> Thing:
    height = rng.uniform(1.35, 1.6)
    shade = color(rng, *VIVID, "white", "grey")
    stand = plain("metal", (0.25, 0.25, 0.27)) if rng.random() < 0.5 else plain("wood", color(rng, "brown"))
    low, wide = rng.uniform(0.17, 0.22), rng.uniform(0.12, 0.17)
    foot = solid(rounded([(0.14, 0), (0.14, 0.02), (0.02, 0.03)]))
    pole = sweep([(0, 0, 0.02), (0, 0, height - 0.1)], 0.012)
    drop = rng.uniform(0.24, 0.32)
    shell = ring([(low, height - drop), (wide, height), (wide - 0.004, height), (low - 0.004, height - drop)], 48)
    cloth = Wardrobe(split, rng).cloth(Color(shade.word, shaded(shade.rgb, 1.1)), metres=0.2)
    return build("lamp", shade, "fabric", (stand, foot, pole), (cloth, shell))


THINGS = (chair, stool, table, sofa, shelf, floor_lamp)
