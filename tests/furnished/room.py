"""The room: boxes and balls that stand in it, as one set of flat Gaussians with a label for each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32

from drsplat.kernels import splat_arrays, view_weights
from drsplat.scene.gaussians import SH_C0, Gaussians
from drsplat.scene.views import View

WIDTH, DEPTH, HEIGHT = (4.6, 3.9, 2.1)  # x, y, z; walls at x = 0 and y = DEPTH, the other sides are open
OPACITY, DISC_SIGMA, DISC_THICKNESS = 0.97, 0.7, 0.06  # sigmas in units of the spacing
GRAIN = 0.04  # of a colour, at most
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

Number = int | float
Vector = tuple[Number, Number, Number]
Points = Float64[np.ndarray, "n 3"]


class Solid(NamedTuple):
    """A box, or a ball, of a size about a middle, in metres from where its thing stands."""

    is_ball: bool
    size: Vector
    at: Vector
    color: Vector


def box(size: Vector, at: Vector, *color: Number) -> Solid:
    return Solid(False, size, at, color)  # type: ignore[arg-type]


def ball(size: Vector, at: Vector, *color: Number) -> Solid:
    return Solid(True, size, at, color)  # type: ignore[arg-type]


Thing = tuple[Vector, Number, Sequence[Solid]]
INVENTORY: dict[str, Thing] = {  # where it stands, the distance between its Gaussians, what it is made of
    "wooden floor": ((2.3, 1.95, 0), 0.042, [box((WIDTH, DEPTH, 0.01), (0, 0, -0.005), 0.64, 0.45, 0.28)]),
    "white wall": ((2.3, 1.95, 1.05), 0.05, [
        box((WIDTH, 0.01, HEIGHT), (0, 1.955, 0), 0.8, 0.775, 0.72),
        box((0.01, DEPTH, HEIGHT), (-2.305, 0, 0), 0.8, 0.775, 0.72),
    ]),
    "green sofa": ((2.25, 3.49, 0), 0.031, [
        box((2, 0.82, 0.45), (0, 0, 0.225), 0.16, 0.46, 0.31), box((2, 0.22, 0.45), (0, 0.3, 0.675), 0.16, 0.46, 0.31),
    ]),
    "grey cat": ((1.88, 3.35, 0.45), 0.013, [
        ball((0.4, 0.22, 0.19), (0, 0, 0.095), 0.46, 0.46, 0.49),
        ball((0.15, 0.14, 0.14), (-0.2, -0.05, 0.155), 0.4, 0.4, 0.43),
    ]),
    "yellow cushion": ((2.86, 3.4, 0.45), 0.016, [ball((0.42, 0.17, 0.4), (0, 0, 0.2), 0.93, 0.72, 0.16)]),
    "wooden table": ((2.25, 1.95, 0), 0.019, [
        box((1.1, 0.6, 0.045), (0, 0, 0.42), 0.55, 0.33, 0.17),
        *(box((0.055, 0.055, 0.4), (x, y, 0.2), 0.45, 0.27, 0.14) for x in (-0.48, 0.48) for y in (-0.24, 0.24)),
    ]),
    "red mug": ((1.93, 1.8, 0.45), 0.006, [ball((0.09, 0.09, 0.105), (0, 0, 0.05), 0.8, 0.09, 0.09)]),
    "blue mug": ((2.58, 1.83, 0.45), 0.006, [ball((0.1, 0.1, 0.11), (0, 0, 0.05), 0.12, 0.28, 0.76)]),
    "green apples": ((2.24, 2.02, 0.45), 0.0085, [
        ball((0.1, 0.1, 0.09), (x, 0, 0.045), 0.52, 0.75, 0.14) for x in (0, 0.1)
    ]),
    "lamp": ((3.62, 3.42, 0), 0.022, [
        box((0.03, 0.03, 1.45), (0, 0, 0.725), 0.2, 0.2, 0.22), ball((0.44, 0.44, 0.3), (0, 0, 1.6), 1.0, 0.86, 0.52),
    ]),
    "orange ball": ((0.95, 0.72, 0), 0.014, [ball((0.32, 0.32, 0.32), (0, 0, 0.16), 0.93, 0.43, 0.09)]),
    "brown teddy": ((3.05, 0.85, 0), 0.015, [
        ball((0.27, 0.23, 0.32), (0, 0, 0.16), 0.5, 0.31, 0.16),
        ball((0.21, 0.19, 0.19), (0, -0.01, 0.375), 0.6, 0.4, 0.22),
        *(ball((0.12, 0.26, 0.12), (x, -0.14, 0.06), 0.78, 0.6, 0.4) for x in (-0.09, 0.09)),
    ]),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Room:
    """gaussians: of all things. labels: of each Gaussian, an index into names."""

    gaussians: Gaussians
    labels: Int32[np.ndarray, " n"]
    names: tuple[str, ...] = tuple(INVENTORY)

    def members(self, *names: str) -> np.ndarray:
        """Boolean mask of the Gaussians of the things named."""
        return np.isin(self.labels, [self.names.index(name) for name in names])

    def seen_from(self, views: Sequence[View], least: float = 3e-5) -> "Room":
        """Without the Gaussians that weigh less than `least` of a picture in all views together.

        Training from photos leaves none there either: a scene has no inside of a sofa.
        """
        splats, total = splat_arrays(self.gaussians), np.zeros(len(self.gaussians))
        for view in (view.resized(320, 240) for view in views):
            found = view_weights(splats, view, np.zeros((view.height, view.width), np.int32), topk=None)
            total[found.gaussian_ids] += found.weights
        seen = np.flatnonzero(total >= least * 320 * 240)
        return Room(self.gaussians.subset(seen), self.labels[seen])


def build_room(coarse: Number = 1.0, moved: Mapping[str, tuple[Vector, Number]] | None = None) -> Room:
    """coarse: stretches the distances; 2 makes a quarter as many. moved: by how much, and turned by degrees."""
    rng, parts = np.random.default_rng(0), []
    for number, (name, (at, spacing, solids)) in enumerate(INVENTORY.items()):
        by, turn = (moved or {}).get(name, ((0, 0, 0), 0))
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        for solid in solids:
            points, normals = (_ball if solid.is_ball else _box)(np.array(solid.size) / 2, spacing * coarse)
            colors = solid.color + GRAIN * rng.uniform(-1, 1, (len(points), 1))
            places = (points + solid.at) @ turned.T + np.add(at, by)
            sizes, labels = np.full(len(points), spacing * coarse), np.full(len(points), number, np.int32)
            parts.append((places, normals @ turned.T, colors, sizes, labels))
    places, normals, colors, sizes, labels = (np.concatenate(part) for part in zip(*parts, strict=True))
    scales = sizes[:, None] * [DISC_SIGMA, DISC_SIGMA, DISC_THICKNESS]
    sh, opacities = ((np.clip(colors, 0, 1) - 0.5) / SH_C0)[:, None], np.full(len(places), OPACITY)
    columns = places, facing(normals), scales, opacities, sh
    return Room(Gaussians(*(column.astype(np.float32) for column in columns)), labels)


def _box(half: np.ndarray, spacing: Number) -> tuple[Points, Points]:
    """Points on the six sides, and their normals."""
    ticks = [((np.arange(n) + 0.5) / n * 2 - 1) * side for side in half for n in [max(2, round(2 * side / spacing))]]
    points, normals = [], []
    for axis in range(3):
        others = [ticks[other] for other in range(3) if other != axis]
        flat = np.stack(np.meshgrid(*others), -1).reshape(-1, 2)
        for side in (-1, 1):
            points.append(np.insert(flat, axis, side * half[axis], axis=1))
            normals.append(np.tile(side * np.eye(3)[axis], (len(flat), 1)))
    return np.concatenate(points), np.concatenate(normals)


def _ball(half: np.ndarray, spacing: Number) -> tuple[Points, Points]:
    """Points on an ellipsoid, and their normals."""
    num = max(12, round(4 * np.pi * np.mean(half) ** 2 / spacing**2))
    z, angle = 1 - (2 * np.arange(num) + 1) / num, GOLDEN_ANGLE * np.arange(num)
    unit = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], 1)
    return unit * half, unit / half / np.linalg.norm(unit / half, axis=1, keepdims=True)


def facing(normals: Points) -> Float64[np.ndarray, "n 4"]:
    """Rotations (wxyz) that take the local z axis to the normals: half turns about the axis between them."""
    half = normals + np.array([0, 0, 1.0])
    length = np.linalg.norm(half, axis=1, keepdims=True)
    half = np.where(length > 1e-6, half / np.maximum(length, 1e-6), [1.0, 0, 0])
    return np.column_stack([np.zeros(len(half)), half])
