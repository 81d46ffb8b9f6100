"""The things in the room, each standing on z = 0 around its own origin, facing -y.

Builders take `coarse`, which stretches the distance between Gaussians (1: the full demo).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from .surfaces import Number, Surface, Vector, box, cone, disc, ellipsoid, joined, quad, tube

Color = tuple[Number, Number, Number]
Colors = Float64[np.ndarray, "n 3"]

WOOD, DARK_WOOD, PALE_WOOD = (0.55, 0.33, 0.17), (0.36, 0.20, 0.10), (0.70, 0.51, 0.32)


@dataclass(frozen=True, eq=False)
class Part:
    """A surface and its colours in [0, 1]. glow: it shines, so that no light or shadow falls on it."""

    surface: Surface
    colors: Colors
    glow: bool = False


Thing = list[Part]


def painted(surface: Surface, color: Color, grain: Number = 0.03, glow: bool = False) -> Part:
    """One colour, with noise that belongs to the place and not to a random state."""
    return Part(
        surface, np.clip(np.array(color) + grain * speckle(surface.points)[:, None], 0, 1), glow
    )


def patterned(
    surface: Surface, pattern: Callable[[Float64[np.ndarray, "n 3"]], Colors], glow: bool = False
) -> Part:
    return Part(
        surface,
        np.clip(pattern(surface.points) + 0.02 * speckle(surface.points)[:, None], 0, 1),
        glow,
    )


def speckle(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Noise in [-1, 1) that is a function of the place."""
    value: np.ndarray = np.sin(points @ [127.1, 311.7, 74.7]) * 43758.5453
    noise: np.ndarray = 2 * (value - np.floor(value)) - 1
    return noise


def placed(thing: Thing, at: Vector, yaw: Number = 0.0, pitch: Number = 0.0) -> Thing:
    return [replace(part, surface=part.surface.placed(at, yaw, pitch)) for part in thing]


def stripes(points: np.ndarray, axis: int, width: Number, colors: tuple[Color, ...]) -> Colors:
    index = np.floor(points[:, axis] / width).astype(int) % len(colors)
    striped: np.ndarray = np.array(colors)[index]
    return striped


def wood_grain(color: Color, axis: int = 0) -> Callable[[np.ndarray], Colors]:
    """Fine lines along `axis`."""

    def pattern(points: np.ndarray) -> Colors:
        across, along = points[:, (axis + 1) % 3] + points[:, (axis + 2) % 3], points[:, axis]
        lines = np.sin(90 * across + 3 * np.sin(2.5 * along)) * 0.5 + np.sin(37 * across) * 0.5
        grained: np.ndarray = np.array(color) * (1 + 0.10 * lines[:, None])
        return grained

    return pattern


def sofa(coarse: Number) -> Thing:
    green, d = (0.16, 0.46, 0.31), 0.031 * coarse
    seat = [box((0.78, 0.70, 0.20), d, 0.05).placed((x, -0.04, 0.36)) for x in (-0.395, 0.395)]
    arms = [box((0.20, 0.86, 0.58), d, 0.08).placed((x, 0, 0.33)) for x in (-0.90, 0.90)]
    back = [
        box((0.80, 0.22, 0.50), d, 0.08).placed((x, 0.30, 0.63), pitch=-8) for x in (-0.40, 0.40)
    ]
    base = box((1.80, 0.80, 0.18), d, 0.02).placed((0, 0, 0.17))
    legs = [
        cone(0.02, 0.03, 0.09, 0.02 * coarse).placed((x, y, 0))
        for x in (-0.85, 0.85)
        for y in (-0.34, 0.34)
    ]
    return [painted(joined(*seat, *arms, *back, base), green), painted(joined(*legs), DARK_WOOD)]


def cushion(coarse: Number) -> Thing:
    return [
        painted(
            ellipsoid((0.21, 0.085, 0.20), 0.016 * coarse).placed((0, 0, 0.20), pitch=-14),
            (0.93, 0.72, 0.16),
        )
    ]


def cat(coarse: Number) -> Thing:
    """Lying, head at -x."""
    d = 0.013 * coarse

    def fur(points: np.ndarray) -> Colors:
        return stripes(
            points + 0.01 * np.sin(40 * points[:, [1]]),
            0,
            0.035,
            ((0.46, 0.46, 0.49), (0.36, 0.36, 0.40)),
        )

    body = ellipsoid((0.20, 0.11, 0.095), d).placed((0, 0, 0.095))
    head = ellipsoid((0.075, 0.07, 0.068), d * 0.8).placed((-0.20, -0.05, 0.155))
    ears = [
        cone(0.026, 0.003, 0.05, d * 0.6).placed((-0.20 + x, -0.045, 0.205)) for x in (-0.04, 0.04)
    ]
    angle = np.linspace(0, 2.4, 20)
    tail = tube(
        np.stack(
            [0.16 + 0.13 * np.sin(angle), -0.13 * (1 - np.cos(angle)) + 0.02, 0 * angle + 0.035], 1
        ),
        0.024,
        d * 0.8,
    )
    paws = [
        ellipsoid((0.06, 0.028, 0.024), d * 0.8).placed((-0.19, y, 0.025)) for y in (-0.07, 0.03)
    ]
    face = [
        ellipsoid((0.010, 0.006, 0.012), d * 0.35).placed((-0.20 + x, -0.116, 0.170))
        for x in (-0.028, 0.028)
    ]
    nose = ellipsoid((0.010, 0.008, 0.007), d * 0.35).placed((-0.20, -0.120, 0.145))
    grey = [
        patterned(joined(body, tail), fur),
        painted(joined(head, *ears, *paws), (0.45, 0.45, 0.48)),
    ]
    return [*grey, painted(joined(*face), (0.75, 0.80, 0.15)), painted(nose, (0.85, 0.50, 0.52))]


def teddy(coarse: Number) -> Thing:
    brown, pale, d = (0.50, 0.31, 0.16), (0.78, 0.60, 0.40), 0.015 * coarse
    body = ellipsoid((0.135, 0.115, 0.16), d).placed((0, 0, 0.16))
    head = ellipsoid((0.105, 0.095, 0.095), d).placed((0, -0.01, 0.375))
    ears = [ellipsoid((0.042, 0.022, 0.042), d * 0.8).placed((x, 0, 0.455)) for x in (-0.08, 0.08)]
    arms = [
        ellipsoid((0.048, 0.048, 0.10), d).placed((x, -0.06, 0.22), yaw=20 * np.sign(x), pitch=-40)
        for x in (-0.14, 0.14)
    ]
    legs = [
        ellipsoid((0.058, 0.13, 0.058), d).placed((x, -0.14, 0.06), yaw=18 * np.sign(x))
        for x in (-0.09, 0.09)
    ]
    soles = [
        ellipsoid((0.045, 0.012, 0.045), d * 0.7).placed((x * 1.42, -0.262, 0.06))
        for x in (-0.09, 0.09)
    ]
    snout = ellipsoid((0.048, 0.042, 0.038), d * 0.7).placed((0, -0.095, 0.355))
    belly = ellipsoid((0.085, 0.03, 0.10), d * 0.8).placed((0, -0.098, 0.16))
    dots = [
        ellipsoid((0.012, 0.008, 0.013), d * 0.35).placed((x, -0.098, 0.40))
        for x in (-0.038, 0.038)
    ]
    dots.append(ellipsoid((0.018, 0.012, 0.013), d * 0.35).placed((0, -0.137, 0.368)))
    fur = [painted(joined(body, head, *ears, *arms, *legs), brown, 0.06)]
    return [
        *fur,
        painted(joined(snout, belly, *soles), pale, 0.04),
        painted(joined(*dots), (0.06, 0.05, 0.05), 0),
    ]


def coffee_table(coarse: Number) -> Thing:
    top = box((1.10, 0.60, 0.045), 0.019 * coarse, 0.012).placed((0, 0, 0.42))
    legs = [
        box((0.055, 0.055, 0.40), 0.018 * coarse).placed((x, y, 0.20))
        for x in (-0.48, 0.48)
        for y in (-0.24, 0.24)
    ]
    shelf = box((0.92, 0.44, 0.02), 0.026 * coarse).placed((0, 0, 0.14))
    return [
        patterned(top, wood_grain(WOOD)),
        patterned(joined(*legs), wood_grain(WOOD, 2)),
        patterned(shelf, wood_grain(WOOD)),
    ]


def mug(color: Color, coarse: Number) -> Thing:
    d = 0.0058 * coarse
    side = joined(cone(0.043, 0.045, 0.105, d), cone(0.039, 0.041, 0.105, d, inward=True))
    rim = cone(0.045, 0.041, 0.003, d).placed((0, 0, 0.105))
    angle = np.linspace(-1.45, 1.45, 16)
    handle = tube(
        np.stack([0.042 + 0.036 * np.cos(angle), 0 * angle, 0.054 + 0.034 * np.sin(angle)], 1),
        0.008,
        d,
    )
    coffee = disc(0.040, d).placed((0, 0, 0.088))
    return [
        painted(joined(side, rim, handle), color, 0.02),
        painted(coffee, (0.20, 0.11, 0.06), 0.01),
    ]


def bowl(coarse: Number) -> Thing:
    d = 0.0085 * coarse
    outside = joined(cone(0.05, 0.11, 0.04, d), cone(0.11, 0.14, 0.05, d).placed((0, 0, 0.04)))
    inside = joined(
        cone(0.04, 0.105, 0.04, d, inward=True).placed((0, 0, 0.005)),
        cone(0.105, 0.137, 0.045, d, inward=True).placed((0, 0, 0.045)),
    )
    return [
        painted(
            joined(outside, inside, disc(0.05, d).placed((0, 0, 0.006))), (1.0, 0.99, 0.96), 0.01
        )
    ]


def apples(coarse: Number) -> Thing:
    d, places = (
        0.0085 * coarse,
        [(0.055, 0.01, 0.075), (-0.045, 0.045, 0.075), (-0.03, -0.055, 0.075), (0.005, 0.0, 0.128)],
    )
    fruits = [ellipsoid((0.044, 0.044, 0.041), d).placed(at) for at in places]
    stalks = [
        tube(np.array([(x, y, z + 0.034), (x + 0.006, y, z + 0.058)]), 0.003, d * 0.5)
        for x, y, z in places
    ]
    return [painted(joined(*fruits), (0.52, 0.75, 0.14), 0.05), painted(joined(*stalks), DARK_WOOD)]


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
        cone(0.13, 0.18, 0.30, d),
        cone(0.19, 0.19, 0.04, d).placed((0, 0, 0.29)),
        disc(0.185, d).placed((0, 0, 0.31)),
    )
    stems, leaves = [], []
    for i in range(19):
        yaw, lean = np.degrees(i * 2.399963), 0.25 + 0.75 * (i / 18)
        reach, top = 0.34 * lean, 1.12 - 0.62 * lean * (i / 18)
        tip = np.array([reach * np.cos(np.radians(yaw)), reach * np.sin(np.radians(yaw)), top])
        middle = tip * [0.35, 0.35, 0.66]
        stems.append(tube(np.array([(0, 0, 0.30), middle, tip]), 0.007, d * 0.8))
        leaves.append(
            _leaf(0.40, 0.15, d * 0.8).placed(tuple(tip.tolist()), yaw - 90, 38 - 75 * lean)
        )
    return [
        painted(pot, (0.72, 0.36, 0.22)),
        painted(joined(*stems), (0.25, 0.42, 0.16)),
        painted(joined(*leaves), (0.20, 0.50, 0.17), 0.07),
    ]


def _leaf(length: Number, width: Number, spacing: Number) -> Surface:
    """From the origin along +y, bent down towards its tip."""
    flat = quad(width, length, spacing)
    t = flat.points[:, 1] / length + 0.5
    leaf = flat.where(
        np.abs(flat.points[:, 0]) < 0.5 * width * np.sin(np.pi * np.clip(t, 0.02, 1) ** 0.8)
    )
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


def books(coarse: Number) -> Thing:
    """On the boards of `shelf`."""
    colors = [
        (0.70, 0.16, 0.15),
        (0.14, 0.30, 0.55),
        (0.88, 0.80, 0.58),
        (0.15, 0.45, 0.38),
        (0.80, 0.48, 0.14),
        (0.38, 0.20, 0.42),
        (0.18, 0.18, 0.22),
    ]
    parts, count = [], 0
    for z, width in ((0.074, 0.62), (0.434, 0.86), (0.794, 0.70), (1.154, 0.50)):
        x = -0.46 if count % 2 == 0 else 0.46 - width
        end = x + width
        while x < end:
            thick, high = 0.030 + 0.004 * (count * 7 % 6), 0.20 + 0.015 * (count * 5 % 7)
            book = box((thick - 0.003, 0.19, high), 0.022 * coarse, 0.003).placed(
                (x + thick / 2, -0.03, z + high / 2)
            )
            parts.append(painted(book, colors[count * 3 % 7], 0.03))
            x, count = x + thick, count + 1
    return parts


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


def ball(coarse: Number) -> Thing:
    def panels(points: np.ndarray) -> Colors:
        seam = (
            np.abs(np.sin(3 * np.arctan2(points[:, 1], points[:, 0])))
            * np.hypot(points[:, 0], points[:, 1])
            < 0.018
        )
        seam |= np.abs(points[:, 2] - 0.16) < 0.008
        return np.where(seam[:, None], (0.25, 0.12, 0.08), (0.93, 0.43, 0.09))

    return [patterned(ellipsoid((0.16, 0.16, 0.16), 0.014 * coarse).placed((0, 0, 0.16)), panels)]


def guitar(coarse: Number) -> Thing:
    """Upright, its strings towards -y."""
    d = 0.014 * coarse

    def hourglass(z: np.ndarray) -> np.ndarray:
        width: np.ndarray = 0.19 * np.sqrt(np.clip(1 - ((z - 0.19) / 0.19) ** 2, 0, 1))
        upper = 0.145 * np.sqrt(np.clip(1 - ((z - 0.38) / 0.14) ** 2, 0, 1))
        waist = np.where((z > 0.19) & (z < 0.38), 0.115, 0)
        outline: np.ndarray = np.maximum(np.maximum(width, upper), waist)
        return outline

    face = quad(0.40, 0.54, d)
    z = face.points[:, 1] + 0.27
    face = face.where(np.abs(face.points[:, 0]) < hourglass(z)).placed((0, -0.045, 0.27), pitch=90)
    rim_z = np.linspace(0.003, 0.515, max(12, round(0.62 / d)))
    rim = np.concatenate(
        [
            np.stack([side * hourglass(rim_z), y + 0 * rim_z, rim_z], 1)
            for side in (-1, 1)
            for y in np.linspace(-0.045, 0.045, max(3, round(0.09 / d)))
        ]
    )
    out = rim * [1, 0, 1] - [0, 0, 0.25]
    rim_surface = Surface(
        rim, out / np.linalg.norm(out, axis=1, keepdims=True), np.full(len(rim), d)
    )
    neck = box((0.045, 0.025, 0.46), d * 0.8).placed((0, -0.045, 0.73))
    head = box((0.07, 0.02, 0.15), d * 0.8).placed((0, -0.04, 1.02))
    hole = disc(0.05, d * 0.6).placed((0, -0.049, 0.33), pitch=90)
    bridge = box((0.13, 0.012, 0.02), d * 0.6).placed((0, -0.052, 0.15))
    dark = painted(joined(neck, head, bridge), (0.20, 0.11, 0.07))
    return [
        painted(face, (0.82, 0.55, 0.24)),
        painted(rim_surface, (0.45, 0.23, 0.10)),
        dark,
        painted(hole, (0.07, 0.05, 0.04), 0),
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


def painting(coarse: Number) -> Thing:
    """1.0 x 0.7, its back against +y: hills under a low sun."""

    def landscape(points: np.ndarray) -> Colors:
        x, z = points[:, 0], points[:, 2]
        sky = np.array([0.98, 0.70, 0.45]) + (z[:, None] - 0.35) * np.array([-1.1, -0.3, 0.9])
        sky = np.where(np.hypot(x - 0.18, z - 0.43)[:, None] < 0.075, (1.0, 0.93, 0.62), sky)
        far = np.where((z < 0.33 + 0.06 * np.sin(7 * x + 1))[:, None], (0.42, 0.40, 0.62), sky)
        near = np.where((z < 0.24 + 0.05 * np.sin(9 * x - 1.2))[:, None], (0.16, 0.36, 0.40), far)
        return np.where((z < 0.12 + 0.03 * np.sin(5 * x))[:, None], (0.08, 0.20, 0.26), near)

    canvas = quad(0.94, 0.64, 0.016 * coarse).placed((0, -0.022, 0.35), pitch=90)
    bars = [
        box((1.0, 0.03, 0.035), 0.014 * coarse).placed((0, -0.015, z)) for z in (0.0175, 0.6825)
    ]
    bars += [
        box((0.035, 0.03, 0.70), 0.014 * coarse).placed((x, -0.015, 0.35))
        for x in (-0.4825, 0.4825)
    ]
    return [patterned(canvas, landscape), painted(joined(*bars), (0.30, 0.19, 0.10))]


def clock(coarse: Number) -> Thing:
    """0.4 across, its back against +y: ten past ten."""
    d = 0.011 * coarse
    face = disc(0.19, d).placed((0, -0.02, 0.2), pitch=90)
    ring = joined(
        cone(0.20, 0.20, 0.03, d), cone(0.187, 0.20, 0.001, d).placed((0, 0, 0.03))
    ).placed((0, 0, 0.2), pitch=90)
    hands = []
    for turn, length in ((-60, 0.10), (60, 0.15)):
        end = (length * np.sin(np.radians(turn)), -0.024, 0.2 + length * np.cos(np.radians(turn)))
        hands.append(tube(np.array([(0, -0.024, 0.2), end]), 0.006, d * 0.5))
    for hour in range(12):
        a = np.radians(30 * hour)
        hands.append(
            ellipsoid((0.008, 0.003, 0.008), d * 0.5).placed(
                (0.16 * np.sin(a), -0.022, 0.2 + 0.16 * np.cos(a))
            )
        )
    return [
        painted(face, (0.96, 0.95, 0.92), 0.01),
        painted(joined(ring, *hands), (0.10, 0.10, 0.12), 0.02),
    ]


def window(coarse: Number) -> Thing:
    """1.0 x 1.2, its back against +y: sky, and a frame with a cross."""

    def sky(points: np.ndarray) -> Colors:
        height = points[:, [2]] / 1.2
        blue = np.array([0.80, 0.91, 1.0]) + height * np.array([-0.32, -0.17, 0.0])
        puff = np.sin(5 * points[:, 0] + 1) + np.sin(8 * points[:, 2] + 3 * points[:, 0]) > 0.95
        return np.where(puff[:, None], (0.98, 0.99, 1.0), blue)

    glass = quad(0.94, 1.14, 0.032 * coarse).placed((0, -0.012, 0.6), pitch=90)
    bars = [
        box((1.0, 0.05, 0.05), 0.018 * coarse).placed((0, -0.025, z)) for z in (0.025, 0.6, 1.175)
    ]
    bars += [
        box((0.05, 0.05, 1.2), 0.018 * coarse).placed((x, -0.025, 0.6)) for x in (-0.475, 0, 0.475)
    ]
    return [patterned(glass, sky, glow=True), painted(joined(*bars), (0.92, 0.91, 0.88), 0.01)]
