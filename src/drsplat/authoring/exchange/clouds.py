"""Scenes and matches for Open3D."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...base.arrays import Float32, Integer
from ...errors import InputError, MissingExtraError
from ...query import Match
from ...scene.gaussians import SH_C0, Gaussians


def to_point_cloud(
    gaussians: Gaussians,
    gaussian_ids: Integer[np.ndarray, " m"] | None = None,
    colors: Float32[np.ndarray, "m 3"] | None = None,
) -> Any:
    """Return an `open3d.geometry.PointCloud` of the centres, in the world.

    gaussian_ids: of a part, such as `answer.gaussian_ids`. colors: RGB in [0, 1]; None: the Gaussians' own.

    Raises: MissingExtraError: Open3D is not installed. InputError: not one colour per point.
    """
    chosen = np.arange(len(gaussians)) if gaussian_ids is None else gaussian_ids
    if colors is not None and len(colors) != len(chosen):
        raise InputError(f"colors: expected {len(chosen)}, one per point, got {len(colors)}")
    rgb = np.clip(0.5 + SH_C0 * gaussians.sh[chosen, 0], 0, 1) if colors is None else colors
    geometry, utility = _open3d()
    cloud = geometry.PointCloud()
    cloud.points = utility.Vector3dVector(np.asarray(gaussians.positions, np.float64)[chosen])
    cloud.colors = utility.Vector3dVector(np.asarray(rgb, np.float64))
    return cloud


def to_boxes(matches: Iterable[Match]) -> list[Any]:
    """Return an `open3d.geometry.OrientedBoundingBox` per match. Raises: MissingExtraError: Open3D is not installed."""
    geometry, _ = _open3d()
    return [geometry.OrientedBoundingBox(match.center, _rotation(match), match.extent) for match in matches]


def _rotation(match: Match) -> np.ndarray:
    """Return the axes of a match as columns, right-handed, as Open3D expects them."""
    columns = np.array(match.axes, np.float64).T
    return columns * (1, 1, np.sign(np.linalg.det(columns)) or 1)


def _open3d() -> tuple[Any, Any]:
    try:
        import open3d
    except ImportError:
        raise MissingExtraError("Open3D is not installed: pip install open3d") from None
    return open3d.geometry, open3d.utility
