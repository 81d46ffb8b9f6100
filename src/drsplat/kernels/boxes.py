"""Boxes about sets of Gaussians, any number of sets at once (native)."""

from typing import NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import Indices, Matrices, OtherIndices, Points, RowIds, Vector3
from ..scene.boxes import Box
from ..scene.gaussians import Gaussians
from .splats import native

OUTLIER_SHARE = 0.003  # of a thing's mass, cut off at each end of each axis
MAX_STRAY_SHARE = 0.02  # of a set's mass, left out as strays at each end of each axis
MIN_TAIL_SPARSENESS = 8.0  # density of the set over that of a tail, in mass per length, for the tail to be strays


class Boxes(NamedTuple):
    """Boxes of several sets, one `Box` each."""

    center: Points
    axes: Matrices
    extent: Points


def box_of(gaussians: Gaussians, ids: RowIds, up: Vector3 | None = None) -> Box:
    """Return the box that holds the Gaussians `ids`, without strays and the outliers of their mass.

    up: a unit direction; the box stands upright, along the principal axes in the plane. None: free, along the
    principal axes. Gaussians count by their opacity. First a halo and floaters are left out: along each axis the tails
    of at most 2 % of the mass that make mass^8 / length of what lies between them largest, so that a tail goes where
    it holds less than an eighth of the mass per length that the thing has. Of the others, along the axes that they have
    without strays, three thousandths of the mixture of normal distributions lie beyond either side of the box.

    Raises: InputError: no ids, or such as there are no Gaussians of.
    Twin: tests/twins/boxes.py::box_of.
    """
    boxes = boxes_of(gaussians, np.array([0, len(ids)], np.int64), ids.astype(np.int64), up, threads=1)
    return Box(boxes.center[0], boxes.axes[0], boxes.extent[0])


def boxes_of(
    gaussians: Gaussians, starts: OtherIndices, ids: Indices, up: Vector3 | None = None, *, threads: int = 0
) -> Boxes:
    """Return the box of each set ids[starts[s]:starts[s + 1]]; the same bits for any number of threads."""
    directions = None if up is None else np.asarray(up, np.float64)
    shapes = gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities
    shares = OUTLIER_SHARE, MAX_STRAY_SHARE, MIN_TAIL_SPARSENESS
    centers, axes, extents = native("boxes", _native.boxes, *shapes, starts, ids, directions, *shares, threads)
    return Boxes(centers + gaussians.origin, axes, extents)
