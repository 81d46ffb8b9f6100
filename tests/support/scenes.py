"""Deterministic random scenes, cameras and mask maps for tests.

Cameras hold float32 numbers only, so that a float32 kernel and its float64 twin get the same ones.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from world.cameras import look_at

from drsplat.scene.gaussians import SH_C0, Gaussians
from drsplat.scene.views import View


def random_gaussians(
    n: int = 3000, seed: int = 0, *, extent: float = 2.0, size: float = 0.15, sh_degree: int = 1
) -> Gaussians:
    """Gaussians in a cube of half width `extent` about the origin.

    Scales are anisotropic about `size` (needles and discs among them); a third is nearly opaque, a
    third translucent, a third faint, as in a trained scene.
    """
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = size * np.exp(rng.normal(-0.5, 0.7, (n, 3)))
    faint, translucent, opaque = rng.uniform(0.01, 0.1, n), rng.uniform(0, 1, n), rng.beta(9, 1, n)
    opacities = np.choose(rng.integers(0, 3, n), [faint, translucent, opaque])
    sh = rng.normal(0, 0.4, (n, (sh_degree + 1) ** 2, 3))
    columns = (rng.uniform(-extent, extent, (n, 3)), quats, scales, opacities, sh)
    return Gaussians(*(column.astype(np.float32) for column in columns))


def gaussians_at(
    means: np.ndarray, size: ArrayLike = 0.012, color: ArrayLike = (0.5, 0.5, 0.5),
    opacity: float = 0.9,
) -> Gaussians:  # fmt: skip
    """Gaussians of one look at some places, along the world's axes. size: of every axis, or of each. color: RGB."""
    count = len(means)
    parts = ([1, 0, 0, 0], 4), (size, 3), (opacity, None), ((np.array(color) - 0.5) / SH_C0, 3)
    quats, scales, opacities, sh = (np.broadcast_to(part, (count, width) if width else count) for part, width in parts)
    columns = np.reshape(means, (count, 3)), quats, scales, opacities, sh[:, None]
    return Gaussians(*(np.array(column, np.float32) for column in columns))


def look_at_view(
    eye: Sequence[float],
    target: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    width: int = 160,
    height: int = 112,
    fov_degrees: float = 60.0,
    principal: tuple[float, float] | None = None,
) -> View:
    """A camera at `eye` that looks at `target`, world +z up; fov is horizontal."""
    view = look_at(eye, target, (width, height), fov_degrees, "view.png")
    intrinsics = view.K.copy()
    intrinsics[:2, 2] = principal or intrinsics[:2, 2]
    return replace(view, K=as_float32(intrinsics), cam_from_world=as_float32(view.cam_from_world))


def as_float32(values: np.ndarray) -> np.ndarray:
    """float64 array of float32-representable numbers."""
    return values.astype(np.float32).astype(np.float64)


def random_mask_map(height: int, width: int, num: int, hole_share: float = 0.1, seed: int = 0) -> np.ndarray:
    """Voronoi cells of `num` random sites, int32; about `hole_share` of the area is -1."""
    rng = np.random.default_rng(seed)
    sites = rng.uniform(0, 1, (num, 2)) * (height, width)
    rows, columns = np.mgrid[:height, :width] + 0.5
    distance = (rows[..., None] - sites[:, 0]) ** 2 + (columns[..., None] - sites[:, 1]) ** 2
    mask_ids = distance.argmin(axis=2).astype(np.int32)
    order = rng.permutation(num)
    area = np.cumsum(np.bincount(mask_ids.ravel(), minlength=num)[order])
    holes = order[area <= hole_share * height * width]
    mask_ids[np.isin(mask_ids, holes)] = -1
    return mask_ids
