"""The small things in the room, each standing on z = 0 around its own origin, facing -y.

Builders take `coarse`, which stretches the distance between Gaussians (1: the full demo).
"""

import numpy as np

from .paint import DARK_WOOD, Color, Colors, Thing, painted, patterned, stripes
from .surfaces import Number, Surface, box, cone, disc, ellipsoid, joined, quad, tube


def cushion(coarse: Number) -> Thing:
    return [painted(ellipsoid((0.21, 0.085, 0.20), 0.016 * coarse).placed((0, 0, 0.20), pitch=-14), (0.93, 0.72, 0.16))]


def cat(coarse: Number) -> Thing:
    """Lying, head at -x."""
    d = 0.013 * coarse

    def fur(points: np.ndarray) -> Colors:
        return stripes(points + 0.01 * np.sin(40 * points[:, [1]]), 0, 0.035, ((0.46, 0.46, 0.49), (0.36, 0.36, 0.40)))

    body = ellipsoid((0.20, 0.11, 0.095), d).placed((0, 0, 0.095))
    head = ellipsoid((0.075, 0.07, 0.068), d * 0.8).placed((-0.20, -0.05, 0.155))
    ears = [cone(0.026, 0.003, 0.05, d * 0.6).placed((-0.20 + x, -0.045, 0.205)) for x in (-0.04, 0.04)]
    angle = np.linspace(0, 2.4, 20)
    tail = tube(
        np.stack([0.16 + 0.13 * np.sin(angle), -0.13 * (1 - np.cos(angle)) + 0.02, 0 * angle + 0.035], 1),
        0.024,
        d * 0.8,
    )
    paws = [ellipsoid((0.06, 0.028, 0.024), d * 0.8).placed((-0.19, y, 0.025)) for y in (-0.07, 0.03)]
    face = [ellipsoid((0.010, 0.006, 0.012), d * 0.35).placed((-0.20 + x, -0.116, 0.170)) for x in (-0.028, 0.028)]
    nose = ellipsoid((0.010, 0.008, 0.007), d * 0.35).placed((-0.20, -0.120, 0.145))
    grey = [patterned(joined(body, tail), fur), painted(joined(head, *ears, *paws), (0.45, 0.45, 0.48))]
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
    legs = [ellipsoid((0.058, 0.13, 0.058), d).placed((x, -0.14, 0.06), yaw=18 * np.sign(x)) for x in (-0.09, 0.09)]
    soles = [ellipsoid((0.045, 0.012, 0.045), d * 0.7).placed((x * 1.42, -0.262, 0.06)) for x in (-0.09, 0.09)]
    snout = ellipsoid((0.048, 0.042, 0.038), d * 0.7).placed((0, -0.095, 0.355))
    belly = ellipsoid((0.085, 0.03, 0.10), d * 0.8).placed((0, -0.098, 0.16))
    dots = [ellipsoid((0.012, 0.008, 0.013), d * 0.35).placed((x, -0.098, 0.40)) for x in (-0.038, 0.038)]
    dots.append(ellipsoid((0.018, 0.012, 0.013), d * 0.35).placed((0, -0.137, 0.368)))
    fur = [painted(joined(body, head, *ears, *arms, *legs), brown, 0.06)]
    return [*fur, painted(joined(snout, belly, *soles), pale, 0.04), painted(joined(*dots), (0.06, 0.05, 0.05), 0)]


def mug(color: Color, coarse: Number) -> Thing:
    d = 0.0058 * coarse
    side = joined(cone(0.043, 0.045, 0.105, d), cone(0.039, 0.041, 0.105, d, inward=True))
    rim = cone(0.045, 0.041, 0.003, d).placed((0, 0, 0.105))
    angle = np.linspace(-1.45, 1.45, 16)
    handle = tube(np.stack([0.042 + 0.036 * np.cos(angle), 0 * angle, 0.054 + 0.034 * np.sin(angle)], 1), 0.008, d)
    coffee = disc(0.040, d).placed((0, 0, 0.088))
    return [painted(joined(side, rim, handle), color, 0.02), painted(coffee, (0.20, 0.11, 0.06), 0.01)]


def bowl(coarse: Number) -> Thing:
    d = 0.0085 * coarse
    outside = joined(cone(0.05, 0.11, 0.04, d), cone(0.11, 0.14, 0.05, d).placed((0, 0, 0.04)))
    inside = joined(
        cone(0.04, 0.105, 0.04, d, inward=True).placed((0, 0, 0.005)),
        cone(0.105, 0.137, 0.045, d, inward=True).placed((0, 0, 0.045)),
    )
    return [painted(joined(outside, inside, disc(0.05, d).placed((0, 0, 0.006))), (1.0, 0.99, 0.96), 0.01)]


def apples(coarse: Number) -> Thing:
    d, places = (
        0.0085 * coarse,
        [(0.055, 0.01, 0.075), (-0.045, 0.045, 0.075), (-0.03, -0.055, 0.075), (0.005, 0.0, 0.128)],
    )
    fruits = [ellipsoid((0.044, 0.044, 0.041), d).placed(at) for at in places]
    stalks = [tube(np.array([(x, y, z + 0.034), (x + 0.006, y, z + 0.058)]), 0.003, d * 0.5) for x, y, z in places]
    return [painted(joined(*fruits), (0.52, 0.75, 0.14), 0.05), painted(joined(*stalks), DARK_WOOD)]


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
            book = box((thick - 0.003, 0.19, high), 0.022 * coarse, 0.003).placed((x + thick / 2, -0.03, z + high / 2))
            parts.append(painted(book, colors[count * 3 % 7], 0.03))
            x, count = x + thick, count + 1
    return parts


def ball(coarse: Number) -> Thing:
    def panels(points: np.ndarray) -> Colors:
        seam = np.abs(np.sin(3 * np.arctan2(points[:, 1], points[:, 0]))) * np.hypot(points[:, 0], points[:, 1]) < 0.018
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
    rim_surface = Surface(rim, out / np.linalg.norm(out, axis=1, keepdims=True), np.full(len(rim), d))
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
    bars = [box((1.0, 0.03, 0.035), 0.014 * coarse).placed((0, -0.015, z)) for z in (0.0175, 0.6825)]
    bars += [box((0.035, 0.03, 0.70), 0.014 * coarse).placed((x, -0.015, 0.35)) for x in (-0.4825, 0.4825)]
    return [patterned(canvas, landscape), painted(joined(*bars), (0.30, 0.19, 0.10))]


def clock(coarse: Number) -> Thing:
    """0.4 across, its back against +y: ten past ten."""
    d = 0.011 * coarse
    face = disc(0.19, d).placed((0, -0.02, 0.2), pitch=90)
    ring = joined(cone(0.20, 0.20, 0.03, d), cone(0.187, 0.20, 0.001, d).placed((0, 0, 0.03))).placed(
        (0, 0, 0.2), pitch=90
    )
    hands = []
    for turn, length in ((-60, 0.10), (60, 0.15)):
        end = (length * np.sin(np.radians(turn)), -0.024, 0.2 + length * np.cos(np.radians(turn)))
        hands.append(tube(np.array([(0, -0.024, 0.2), end]), 0.006, d * 0.5))
    for hour in range(12):
        a = np.radians(30 * hour)
        hands.append(
            ellipsoid((0.008, 0.003, 0.008), d * 0.5).placed((0.16 * np.sin(a), -0.022, 0.2 + 0.16 * np.cos(a)))
        )
    return [painted(face, (0.96, 0.95, 0.92), 0.01), painted(joined(ring, *hands), (0.10, 0.10, 0.12), 0.02)]
