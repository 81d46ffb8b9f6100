"""The large things in the room, each standing on z = 0 around its own origin, facing -y.

Builders take `coarse`, which stretches the distance between Gaussians (1: the full demo).
"""

import numpy as np

from .paint import DARK_WOOD, PALE_WOOD, WOOD, Colors, Thing, painted, patterned, stripes, wood_grain
from .surfaces import Number, Surface, box, cone, disc, joined, quad, tube


def sofa(coarse: Number) -> Thing:
    green, d = (0.16, 0.46, 0.31), 0.031 * coarse
    seat = [box((0.78, 0.70, 0.20), d, 0.05).placed((x, -0.04, 0.36)) for x in (-0.395, 0.395)]
    arms = [box((0.20, 0.86, 0.58), d, 0.08).placed((x, 0, 0.33)) for x in (-0.90, 0.90)]
    back = [box((0.80, 0.22, 0.50), d, 0.08).placed((x, 0.30, 0.63), pitch=-8) for x in (-0.40, 0.40)]
    base = box((1.80, 0.80, 0.18), d, 0.02).placed((0, 0, 0.17))
    legs = [cone(0.02, 0.03, 0.09, 0.02 * coarse).placed((x, y, 0)) for x in (-0.85, 0.85) for y in (-0.34, 0.34)]
    return [painted(joined(*seat, *arms, *back, base), green), painted(joined(*legs), DARK_WOOD)]


def coffee_table(coarse: Number) -> Thing:
    top = box((1.10, 0.60, 0.045), 0.019 * coarse, 0.012).placed((0, 0, 0.42))
    legs = [
        box((0.055, 0.055, 0.40), 0.018 * coarse).placed((x, y, 0.20)) for x in (-0.48, 0.48) for y in (-0.24, 0.24)
    ]
    shelf = box((0.92, 0.44, 0.02), 0.026 * coarse).placed((0, 0, 0.14))
    return [
        patterned(top, wood_grain(WOOD)),
        patterned(joined(*legs), wood_grain(WOOD, 2)),
        patterned(shelf, wood_grain(WOOD)),
    ]


def floor_lamp(coarse: Number) -> Thing:
    d = 0.022 * coarse
    stand = joined(
        cone(0.15, 0.14, 0.025, d),
        disc(0.14, d).placed((0, 0, 0.025)),
        cone(0.013, 0.013, 1.45, d * 0.7).placed((0, 0, 0.025)),
    )
    shade = joined(
        cone(0.22, 0.15, 0.30, d).placed((0, 0, 1.46)),
        disc(0.21, d).placed((0, 0, 1.465)),
        disc(0.145, d).placed((0, 0, 1.755)),
    )
    return [painted(stand, (0.20, 0.20, 0.22)), painted(shade, (1.0, 0.86, 0.52), 0.015, glow=True)]


def plant(coarse: Number) -> Thing:
    d = 0.020 * coarse
    pot = joined(
        cone(0.13, 0.18, 0.30, d), cone(0.19, 0.19, 0.04, d).placed((0, 0, 0.29)), disc(0.185, d).placed((0, 0, 0.31))
    )
    stems, leaves = [], []
    for i in range(19):
        yaw, lean = np.degrees(i * 2.399963), 0.25 + 0.75 * (i / 18)
        reach, top = 0.34 * lean, 1.12 - 0.62 * lean * (i / 18)
        tip = np.array([reach * np.cos(np.radians(yaw)), reach * np.sin(np.radians(yaw)), top])
        middle = tip * [0.35, 0.35, 0.66]
        stems.append(tube(np.array([(0, 0, 0.30), middle, tip]), 0.007, d * 0.8))
        leaves.append(_leaf(0.40, 0.15, d * 0.8).placed(tuple(tip.tolist()), yaw - 90, 38 - 75 * lean))
    return [
        painted(pot, (0.72, 0.36, 0.22)),
        painted(joined(*stems), (0.25, 0.42, 0.16)),
        painted(joined(*leaves), (0.20, 0.50, 0.17), 0.07),
    ]


def _leaf(length: Number, width: Number, spacing: Number) -> Surface:
    """From the origin along +y, bent down towards its tip."""
    flat = quad(width, length, spacing)
    t = flat.points[:, 1] / length + 0.5
    leaf = flat.where(np.abs(flat.points[:, 0]) < 0.5 * width * np.sin(np.pi * np.clip(t, 0.02, 1) ** 0.8))
    t, side = leaf.points[:, 1] / length + 0.5, leaf.points[:, 0]
    leaf.points[:, 1] = t * length
    leaf.points[:, 2] = 0.3 * length * (t - 1.4 * t**2) + 0.4 * np.abs(side)
    return leaf


def shelf(coarse: Number) -> Thing:
    """1.0 wide, 1.5 high; its back against +y."""
    d = 0.031 * coarse
    boards = [box((0.96, 0.30, 0.028), d).placed((0, 0, z)) for z in (0.06, 0.42, 0.78, 1.14, 1.49)]
    sides = [box((0.028, 0.30, 1.50), d).placed((x, 0, 0.75)) for x in (-0.49, 0.49)]
    back = quad(0.96, 1.44, d * 1.2).placed((0, 0.145, 0.77), pitch=90)
    return [
        patterned(joined(*boards), wood_grain(PALE_WOOD)),
        patterned(joined(*sides), wood_grain(PALE_WOOD, 2)),
        painted(back, (0.60, 0.43, 0.27)),
    ]


def chair(coarse: Number) -> Thing:
    d = 0.017 * coarse
    seat = box((0.44, 0.42, 0.035), d, 0.012).placed((0, 0, 0.45))
    front = [box((0.038, 0.038, 0.44), d).placed((x, -0.18, 0.22)) for x in (-0.19, 0.19)]
    rear = [box((0.038, 0.038, 0.94), d).placed((x, 0.19, 0.47)) for x in (-0.19, 0.19)]
    slats = [box((0.36, 0.018, 0.07), d).placed((0, 0.19, z)) for z in (0.64, 0.76, 0.89)]
    rungs = [box((0.02, 0.34, 0.03), d).placed((x, 0, 0.2)) for x in (-0.19, 0.19)]
    return [
        patterned(joined(seat, *slats), wood_grain(PALE_WOOD)),
        patterned(joined(*front, *rear, *rungs), wood_grain(PALE_WOOD, 2)),
    ]


def rug(coarse: Number) -> Thing:
    def weave(points: np.ndarray) -> Colors:
        bands = stripes(
            points + np.array([1.2, 0, 0]),
            0,
            0.15,
            ((0.55, 0.20, 0.45), (0.90, 0.85, 0.76), (0.36, 0.22, 0.50), (0.90, 0.85, 0.76)),
        )
        edge = (np.abs(points[:, 0]) > 1.13) | (np.abs(points[:, 1]) > 0.73)
        return np.where(edge[:, None], (0.30, 0.16, 0.36), bands)

    return [patterned(quad(2.4, 1.6, 0.030 * coarse).placed((0, 0, 0.015)), weave)]


def window(coarse: Number) -> Thing:
    """1.0 x 1.2, its back against +y: sky, and a frame with a cross."""

    def sky(points: np.ndarray) -> Colors:
        height = points[:, [2]] / 1.2
        blue = np.array([0.80, 0.91, 1.0]) + height * np.array([-0.32, -0.17, 0.0])
        puff = np.sin(5 * points[:, 0] + 1) + np.sin(8 * points[:, 2] + 3 * points[:, 0]) > 0.95
        return np.where(puff[:, None], (0.98, 0.99, 1.0), blue)

    glass = quad(0.94, 1.14, 0.032 * coarse).placed((0, -0.012, 0.6), pitch=90)
    bars = [box((1.0, 0.05, 0.05), 0.018 * coarse).placed((0, -0.025, z)) for z in (0.025, 0.6, 1.175)]
    bars += [box((0.05, 0.05, 1.2), 0.018 * coarse).placed((x, -0.025, 0.6)) for x in (-0.475, 0, 0.475)]
    return [patterned(glass, sky, glow=True), painted(joined(*bars), (0.92, 0.91, 0.88), 0.01)]
