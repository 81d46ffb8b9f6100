"""Surfaces as evenly spread points with normals, in metres, +z up: what furniture is built from."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
Number = int | float
Vector = tuple[Number, Number, Number]
Points = Float64[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class Surface:
    """points, unit normals, and the distance between neighbouring points, in metres."""

    points: Points
    normals: Points
    spacing: Float64[np.ndarray, " n"]

    def placed(self, at: Vector = (0, 0, 0), yaw: Number = 0.0, pitch: Number = 0.0) -> "Surface":
        """Tilted about x by `pitch`, then turned about z by `yaw` (degrees), then moved."""
        c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        c, s = np.cos(np.radians(pitch)), np.sin(np.radians(pitch))
        turn = turn @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        return replace(self, points=self.points @ turn.T + at, normals=self.normals @ turn.T)

    def where(self, keep: np.ndarray) -> "Surface":
        return Surface(self.points[keep], self.normals[keep], self.spacing[keep])


def joined(*surfaces: Surface) -> Surface:
    return Surface(
        np.concatenate([s.points for s in surfaces]),
        np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.spacing for s in surfaces]),
    )


def quad(width: Number, depth: Number, spacing: Number) -> Surface:
    """A rectangle in the xy plane about the origin, facing +z."""
    x, y = _ticks(width, spacing), _ticks(depth, spacing)
    grid = np.stack(np.meshgrid(x, y, [0.0], indexing="ij"), -1).reshape(-1, 3)
    return _surface(grid, np.broadcast_to([0.0, 0.0, 1.0], grid.shape), spacing)


def box(size: Vector, spacing: Number, rounding: Number = 0.0) -> Surface:
    """A box about the origin whose edges are rounded with radius `rounding`."""
    half = np.array(size) / 2
    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        a, b = np.meshgrid(_ticks(size[u], spacing), _ticks(size[v], spacing), indexing="ij")
        for side in (-1.0, 1.0):
            points = np.zeros((a.size, 3))
            points[:, axis], points[:, u], points[:, v] = side * half[axis], a.ravel(), b.ravel()
            faces.append(_rounded(points, half, rounding, axis, side))
    points, normals = (np.concatenate(part) for part in zip(*faces, strict=True))
    return _surface(points, normals, spacing)


def _rounded(points: Points, half: np.ndarray, radius: Number, axis: int, side: float) -> tuple[Points, Points]:
    normals = np.zeros_like(points)
    normals[:, axis] = side
    if radius == 0:
        return points, normals
    radius = min(radius, half.min() * 0.999)
    core = np.clip(points, radius - half, half - radius)
    normals = points - core
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return core + radius * normals, normals


def ellipsoid(radii: Vector, spacing: Number) -> Surface:
    a, b, c = (r**1.6 for r in radii)
    area = 4 * np.pi * ((a * b + a * c + b * c) / 3) ** (1 / 1.6)  # Thomsen's formula
    num = max(12, round(area / spacing**2))
    z = 1 - (2 * np.arange(num) + 1) / num
    ring, angle = np.sqrt(1 - z * z), GOLDEN_ANGLE * np.arange(num)
    unit = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1)
    normals = unit / radii
    return _surface(unit * radii, normals / np.linalg.norm(normals, axis=1, keepdims=True), spacing)


def disc(radius: Number, spacing: Number) -> Surface:
    """In the xy plane about the origin, facing +z."""
    num = max(6, round(np.pi * radius**2 / spacing**2))
    r, angle = radius * np.sqrt((np.arange(num) + 0.5) / num), GOLDEN_ANGLE * np.arange(num)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros(num)], 1)
    return _surface(points, np.broadcast_to([0.0, 0.0, 1.0], points.shape), spacing)


def cone(bottom: Number, top: Number, height: Number, spacing: Number, inward: bool = False) -> Surface:
    """The side of a cone frustum on z = 0, from radius `bottom` to radius `top`; equal: a cylinder."""
    slant = np.hypot(height, bottom - top)
    rings = []
    for t in (np.arange(n := max(2, round(slant / spacing))) + 0.5) / n:
        radius = bottom + (top - bottom) * t
        angle = np.arange(m := max(6, round(2 * np.pi * radius / spacing))) * (2 * np.pi / m) + 2.4 * t
        rings.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(m, height * t)], 1))
    points = np.concatenate(rings)
    radial = points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    normals = np.column_stack([radial * height, np.full(len(points), bottom - top)]) / slant
    return _surface(points, -normals if inward else normals, spacing)


def tube(path: Points, radius: Number, spacing: Number) -> Surface:
    """A round rod along a polyline."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0], np.cumsum(steps)])
    at = (np.arange(n := max(3, round(along[-1] / spacing))) + 0.5) / n * along[-1]
    centers = np.stack([np.interp(at, along, path[:, k]) for k in range(3)], 1)
    forward = np.gradient(centers, axis=0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    side = np.cross(forward, [0.31, 0.95, 0.05])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = np.arange(m := max(5, round(2 * np.pi * radius / spacing))) * (2 * np.pi / m)
    normals = side[:, None] * np.cos(angle)[:, None] + np.cross(forward, side)[:, None] * np.sin(angle)[:, None]
    return _surface((centers[:, None] + radius * normals).reshape(-1, 3), normals.reshape(-1, 3), spacing)


def _ticks(length: Number, spacing: Number) -> Float64[np.ndarray, " n"]:
    num = max(2, round(length / spacing))
    ticks: np.ndarray = ((np.arange(num) + 0.5) / num - 0.5) * length
    return ticks


def _surface(points: np.ndarray, normals: np.ndarray, spacing: Number) -> Surface:
    return Surface(points, np.array(normals), np.full(len(points), spacing))
