"""Oriented boxes about sets of Gaussians: upright ones and free ones."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from ..base.arrays import Array, Float64, Matrix3, RowIds, Vector3, WholeNumbers
from ..errors import InputError
from .parted import AnyGaussians
from .views import View

BoxKind = Literal["upright", "free"]
KINDS: tuple[BoxKind, ...] = get_args(BoxKind)

HAZE_OPACITY = 0.1  # fainter Gaussians do not make an object, as in OpenGaussian's protocol
MIN_LEVEL_SPREAD = 0.1  # of the cameras' horizontals: with less, they do not say which way is up


class Box(NamedTuple):
    """Oriented box in world coordinates and scene units.

    axes: row a is the unit direction of the full length extent[a]; right-handed. Upright: the third axis is up,
    the first the longer of the other two. Free: the longest first.
    """

    center: Vector3
    axes: Matrix3
    extent: Vector3


def upward(views: Sequence[View]) -> Vector3:
    """Return the unit direction that is up in most photos: people hold cameras level, whatever they point them at.

    It is square to the horizontals of all photos, or the mean of their ups where the horizontals lie along one line.

    Raises: InputError: no views, or they look up and down alike.
    """
    return upward_of(camera_axes(views))


def camera_axes(views: Sequence[View]) -> Float64[Array, "v 2 3"]:
    """Return the right and down axes of each camera, in the world; `upward` needs nothing else."""
    return np.array([view.cam_from_world[:2, :3] for view in views], np.float64).reshape(-1, 2, 3)


def upward_of(axes: Float64[Array, "v 2 3"]) -> Vector3:
    """Return the upward direction from `camera_axes`; see `upward`. Raises: InputError: as `upward`."""
    if not len(axes):
        raise InputError("which way is up is told by the photos, and this scene has none")
    total = -axes[:, 1].sum(0)
    length = float(np.linalg.norm(total))
    if length < 0.1 * len(axes):
        raise InputError("the photos of this scene do not agree on which way is up")
    level = axes[:, 0]
    spread, directions = np.linalg.eigh(level.T @ level / len(axes))
    square = directions[:, 0] * np.sign(directions[:, 0] @ total)
    if spread[1] < MIN_LEVEL_SPREAD or square @ total < 0.5 * length:
        return total / length
    return np.asarray(square)


def up_of(views: Sequence[View]) -> Vector3 | None:
    """Return the upward direction (`upward`), or None where the photos do not tell."""
    try:
        return upward(views)
    except InputError:
        return None


def solid(gaussians: AnyGaussians, ids: RowIds) -> WholeNumbers:
    """Return the ids of the Gaussians opaque enough to be seen; all ids if none is."""
    visible: Array = ids[gaussians.opacities_of(ids) >= HAZE_OPACITY]
    return visible if len(visible) else ids
