"""A furnished room of Gaussians with the statistics of a trained scene, for benchmarks.

Flat Gaussians on walls, boxes and balls: log-normal sizes, a mixture of faint and solid opacities, as
3DGS training leaves them. With the default density about 65 Gaussians add to each pixel.
"""

import numpy as np

from drsplat import Gaussians, View, ViewFeatures

SIZE = np.array([6.0, 5.0, 2.8])
NUM_OBJECTS = 40


def _plane(rng, n, corner, u, v):
    a, b = rng.random((2, n, 1))
    normal = np.cross(u, v)
    return corner + a * u + b * v, np.tile(normal / np.linalg.norm(normal), (n, 1))


def _ball(rng, n, center, radius):
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return center + radius * direction, direction


def _box(rng, n, center, size):
    axis, side = rng.integers(0, 3, n), rng.choice([-1.0, 1.0], n)
    points = rng.random((n, 3)) - 0.5
    points[np.arange(n), axis] = side / 2
    normals = np.zeros((n, 3))
    normals[np.arange(n), axis] = side
    return center + points * size, normals


def _surfaces(rng, n):
    x, y, z = np.diag(SIZE)
    zero = np.zeros(3)
    shell = [(zero, x, y), (z, x, y), (zero, x, z), (y, x, z), (zero, y, z), (x, y, z)]
    parts = [_plane(rng, int(0.07 * n), *plane) for plane in shell]
    each = (n - 6 * int(0.07 * n)) // NUM_OBJECTS
    for i in range(NUM_OBJECTS):
        count = each if i else n - 6 * int(0.07 * n) - each * (NUM_OBJECTS - 1)
        center = rng.uniform([0.4, 0.4, 0.1], [SIZE[0] - 0.4, SIZE[1] - 0.4, 1.4])
        solid = (
            _ball(rng, count, center, rng.uniform(0.08, 0.35))
            if i % 2
            else _box(rng, count, center, rng.uniform(0.1, 0.8, 3))
        )
        parts.append(solid)
    return (np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def _quats_to(normals, rng):
    """wxyz rotations that turn +z to the normals, with a random spin about them."""
    tilt = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], 1)
    tilt[normals[:, 2] < -0.9999] = [0, 1, 0, 0]
    half = rng.uniform(0, np.pi, len(normals))
    c, s = np.cos(half)[:, None], np.sin(half)[:, None]
    w, x, y, z = np.split(tilt, 4, 1)
    quats = np.hstack([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s])
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def room(n: int, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    points, normals = _surfaces(rng, n)
    points = points + normals * rng.normal(0, 0.015, (n, 1))
    normals = normals + rng.normal(0, 0.15, (n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scales = 0.012 * np.exp(rng.normal(0, 0.75, (n, 1)) + rng.normal(0, 0.45, (n, 3)))
    scales[:, 2] *= 0.15
    faint, solid = 0.95 * rng.beta(1.0, 4.5, n) + 0.005, 0.985 * rng.beta(3, 1.2, n) + 0.01
    opacities = np.where(rng.random(n) < 0.62, faint, solid)
    order = rng.permutation(n)
    f32 = lambda a: np.ascontiguousarray(a[order], np.float32)  # noqa: E731
    sh = rng.normal(0, 0.5, (n, 1, 3))
    return Gaussians(f32(points), f32(_quats_to(normals, rng)), f32(np.minimum(scales, 0.5)), f32(opacities), f32(sh))


def room_views(count: int, width: int = 1000, height: int = 730, seed: int = 1) -> list[View]:
    """Cameras on an ellipse inside the room, looking across it; 65 degrees wide."""
    rng = np.random.default_rng(seed)
    focal = width / 2 / np.tan(np.deg2rad(65) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    views = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        eye = np.array([3 + 1.7 * np.cos(angle), 2.5 + 1.4 * np.sin(angle), 1.5 + 0.2 * rng.normal()])
        target = np.array([3 - 1.5 * np.cos(angle + 0.4), 2.5 - 1.3 * np.sin(angle + 0.4), 1 + 0.2 * rng.normal()])
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ eye
        views.append(View(f"{i:05d}.png", K, pose, width, height))
    return views


def mask_map(width: int, height: int, count: int, seed: int, hole_share: float = 0.08) -> np.ndarray:
    """Cells of uneven size with wavy borders, as a segmenter leaves them; some of them without a mask."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    centers = rng.random((3 * count, 2)) * [width, height]
    labels = rng.zipf(1.6, 3 * count) % count
    labels[:count] = np.arange(count)
    labels[rng.random(3 * count) < hole_share] = -1
    y, x = np.mgrid[0:height, 0:width]
    points = np.stack([x + 6 * np.sin(y / 17), y + 6 * np.cos(x / 13)], -1).reshape(-1, 2)
    return labels[cKDTree(centers).query(points)[1]].astype(np.int32).reshape(height, width)


def unit_rows(rng: np.random.Generator, n: int, dim: int) -> np.ndarray:
    rows = rng.standard_normal((n, dim), np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


class SyntheticFeatures(dict):
    """Segment maps and embeddings made when they are asked for, so that they cost no memory."""

    def __init__(self, views: list[View], masks: int, dim: int) -> None:
        super().__init__({view.name: view for view in views})
        self.masks, self.dim, self.seconds = masks, dim, 0.0

    def __getitem__(self, name: str) -> ViewFeatures:
        from time import perf_counter

        start, view = perf_counter(), super().__getitem__(name)
        seed = int(name[:5])
        ids = mask_map(view.width // 2, view.height // 2, self.masks, seed)
        found = ViewFeatures(ids, unit_rows(np.random.default_rng(seed), self.masks, self.dim))
        self.seconds += perf_counter() - start
        return found
