"""Toys."""

from dataclasses import replace

import numpy as np

from ..looks import VIVID, Split, color, plain, shaded
from ..meshes import box, cylinder, extrude, rounded, solid, sphere, sweep
from ..thing import Thing, build

Rng = np.random.Generator
WHITE = (0.93, 0.92, 0.89)
INK = (0.05, 0.05, 0.06)


def ball(rng: Rng, split: Split) -> Thing:
    """Six gores, alternately of the ball's colour and white, or two rings round it."""
    radius = rng.uniform(0.08, 0.13)
    shade = color(rng, *VIVID)
    sphere_ = sphere(radius, sides=48)
    corners = sphere_.vertices[sphere_.faces]
    if rng.random() < 0.6:
        angle = np.arctan2(corners[..., 1], corners[..., 0])
        gore = np.floor((angle.max(1) + angle.min(1) + 2 * np.pi) / (2 * np.pi / 3)).astype(int)
        white = (gore % 2 == 1) & (corners[..., 2].max(1) < 0.97 * radius)
    else:  # by the upper edge, the same for both triangles of a cell
        white = np.abs(np.abs(corners[..., 2].max(1) / radius - 0.03) - 0.33) < 0.12
    colored, pale = (replace(sphere_, faces=sphere_.faces[chosen]) for chosen in (~white, white))
    return build(
        "ball", shade, "rubber",
        (plain("rubber", shade), colored), (plain("rubber", WHITE), pale), turns=[("y", rng.uniform(15, 50))],
    )  # fmt: skip


def duck(rng: Rng, split: Split) -> Thing:
    """A bath duck."""
    size = rng.uniform(0.8, 1.6)
    shade = color(rng, "yellow", "yellow", "yellow", "pink", "blue", "green", "white")
    body = sphere(0.045, 0.034, 0.030).moved(z=0.030)
    chest = sphere(0.026, 0.026, 0.026).moved(0.022, 0, 0.036)
    tail = sweep(
        [(-0.030, 0, 0.036), (-0.046, 0, 0.047), (-0.056, 0, 0.064)], [(0.016, 0.022), (0.010, 0.015), (0.002, 0.005)]
    )
    head = sphere(0.023 * rng.uniform(0.95, 1.15)).moved(0.025, 0, 0.075)
    wings = [
        sphere(0.024, 0.007, 0.015).turned("y", 18).turned("z", s * -8).moved(-0.007, s * 0.031, 0.036) for s in (1, -1)
    ]
    beak = plain("rubber", (0.93, 0.40, 0.08) if shade.word != "orange" else (0.85, 0.15, 0.1))
    bill = [sphere(0.012, 0.011, 0.0038).moved(0.049, 0, z) for z in (0.073, 0.0685)]
    eyes = [sphere(0.0036).moved(0.0425, s * 0.0125, 0.0825) for s in (1, -1)]
    return build(
        "toy duck", shade, "rubber",
        (plain("rubber", shade), body, chest, tail, head, *wings), (beak, *bill), (plain("plastic", INK), *eyes),
        scale=size,
    )  # fmt: skip


def bear(rng: Rng, split: Split) -> Thing:
    """A sitting teddy bear."""
    size = rng.uniform(0.8, 1.5)
    shade = color(rng, "brown", "brown", "white", "pink", "grey", "blue")
    fat = rng.uniform(0.95, 1.15)
    body = sphere(0.058 * fat, 0.062 * fat, 0.075).moved(z=0.075)
    head = sphere(0.050, 0.056, 0.050).moved(0.012, 0, 0.175)
    ears = [sphere(0.010, 0.021, 0.021).moved(0.004, s * 0.044, 0.216) for s in (1, -1)]
    arms = [
        sphere(0.022, 0.021, 0.046).turned("x", s * 38).turned("y", -35).moved(0.032, s * 0.070, 0.105) for s in (1, -1)
    ]
    legs = [sphere(0.054, 0.026, 0.027).turned("z", s * 22).moved(0.068, s * 0.050, 0.028) for s in (1, -1)]
    pale = plain("plush", shaded(shade.rgb, 1.5) if min(shade.rgb) < 0.7 else (0.75, 0.62, 0.5))
    muzzle = sphere(0.022, 0.026, 0.020).moved(0.054, 0, 0.163)
    tummy = sphere(0.026, 0.040, 0.048).moved(0.058 * fat - 0.018, 0, 0.078)
    inner = [sphere(0.004, 0.013, 0.013).moved(0.0115, s * 0.044, 0.216) for s in (1, -1)]
    soles = [sphere(0.007, 0.018, 0.019).turned("z", s * 22).moved(0.1135, s * 0.0685, 0.029) for s in (1, -1)]
    nose = sphere(0.006, 0.009, 0.006).moved(0.0755, 0, 0.170)
    eyes = [sphere(0.006).moved(0.0555, s * 0.021, 0.188) for s in (1, -1)]
    return build(
        "teddy bear", shade, "plush",
        (plain("plush", shade), body, head, *ears, *arms, *legs), (pale, muzzle, tummy, *inner, *soles),
        (plain("plastic", INK), nose, *eyes), scale=size,
    )  # fmt: skip


def car(rng: Rng, split: Split) -> Thing:
    """A toy car, driving towards +x."""
    size, shade = rng.uniform(0.9, 1.5), color(rng, *VIVID, "white", "black")
    tall = rng.uniform(0.92, 1.15)
    side = rounded(
        [(-0.075, 0.014), (0.073, 0.014), (0.078, 0.030), (0.072, 0.040), (0.038, 0.044), (-0.072, 0.045),
         (-0.078, 0.030), (-0.075, 0.014)]
    )[:-1]  # fmt: skip
    body = extrude(side, 0.068).turned("x", 90).moved(y=0.034)
    back = float(rng.uniform(-0.066, -0.045))
    roof = rounded([(back, 0.043), (0.036, 0.043), (0.012, 0.068 * tall), (back + 0.016, 0.068 * tall), (back, 0.043)])[
        :-1
    ]
    cabin = extrude(roof, 0.056).turned("x", 90).moved(y=0.028)
    middle = np.array([(back + 0.036) / 2, 0.055])
    panes = [tuple((middle + (np.array(p) - middle) * [0.80, 0.72]).tolist()) for p in roof]
    glass = extrude(panes, 0.0575).turned("x", 90).moved(y=0.02875)
    front = box((0.002, 0.046, 0.020)).turned("y", -43).moved(0.0285, 0, 0.0475)
    wheel = cylinder(0.0165, 0.016, 0.003, 28).turned("x", 90).moved(y=0.008)
    hub = cylinder(0.008, 0.0172, 0, 20).turned("x", 90).moved(y=0.0086)
    places = [(x, y, 0.0165) for x in (-0.046, 0.046) for y in (-0.031, 0.031)]
    lamps = [sphere(0.004, 0.007, 0.006).moved(0.0755, s * 0.022, 0.032) for s in (1, -1)]
    rear = [sphere(0.003, 0.006, 0.005).moved(-0.0755, s * 0.022, 0.033) for s in (1, -1)]
    return build(
        "toy car", shade, "plastic",
        (plain("plastic", shade), body, cabin),
        (plain("glass", (0.16, 0.20, 0.24)), glass, front),
        (plain("rubber", (0.07, 0.07, 0.08)), *(wheel.moved(*p) for p in places)),
        (plain("plastic", (0.8, 0.8, 0.8)), *(hub.moved(*p) for p in places), *lamps),
        (plain("plastic", (0.7, 0.05, 0.05)), *rear),
        scale=size,
    )  # fmt: skip


def blocks(rng: Rng, split: Split) -> Thing:
    """A stacking toy: rings of falling size on a rod, one colour."""
    shade = color(rng, *VIVID)
    looks = [plain("plastic", shade), plain("plastic", shaded(shade.rgb, 0.8))]
    count, size = int(rng.integers(4, 6)), rng.uniform(0.045, 0.06)
    pieces, z = [(plain("wood", (0.72, 0.52, 0.32)), cylinder(size * 1.1, 0.012, 0.004))], 0.012
    for k in range(count):
        r, h = size * (1 - 0.14 * k), size * 0.44
        ring = solid(rounded([(r * 0.7, 0), (r, 0), (r, h), (r * 0.7, h)], 3))
        pieces.append((looks[k % 2], ring.moved(z=z)))
        z += h
    pieces.append((plain("wood", (0.72, 0.52, 0.32)), sphere(size * 0.3).moved(z=z + size * 0.18)))
    return build("stacking toy", shade, "plastic", *pieces)


THINGS = (ball, duck, bear, car, blocks)
