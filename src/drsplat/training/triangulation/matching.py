"""Keypoints of two photos that may show one place: similar, and on each other's epipolar line."""

from typing import NamedTuple

import numpy as np

from ...base.arrays import Bool, Float64, Integer
from ...scene.views import View
from .keypoints import Keypoints

MAX_DISTANCE_RATIO = 0.8  # Lowe's ratio test: nearest over second nearest
MAX_EPIPOLAR_SHARE = 1 / 320  # of the photo's longer side; 2 pixels of 640


class Matches(NamedTuple):
    """Matches of two photos. pairs: indices into their keypoints. alike: number before the epipolar test."""

    pairs: Integer[np.ndarray, "m 2"]
    alike: int


def matches(first: View, a: Keypoints, second: View, b: Keypoints) -> Matches:
    """Match mutually nearest descriptors, and keep the pairs that the poses allow."""
    pairs = _alike(a, b)
    fits = _fits(first, a.pixels[pairs[:, 0]], second, b.pixels[pairs[:, 1]])
    return Matches(pairs[fits], len(pairs))


def _alike(a: Keypoints, b: Keypoints) -> Integer[np.ndarray, "m 2"]:
    """Return pairs of mutual nearest neighbours that pass the ratio test.  Source: Lowe 2004, Sec. 7.1."""
    if len(a.descriptors) < 2 or len(b.descriptors) < 2:
        return np.empty((0, 2), np.int64)
    distances2 = _distances2(a, b)
    forward, backward = _nearest(distances2), _nearest(distances2.T)
    mutual = (forward >= 0) & (backward[forward] == np.arange(len(forward)))
    return np.stack([np.flatnonzero(mutual), forward[mutual]], axis=1)


def _distances2(a: Keypoints, b: Keypoints) -> np.ndarray:
    """Compute squared distances of all descriptors. Exact in float32: integers below 2**24."""
    left, right = a.descriptors.astype(np.float32), b.descriptors.astype(np.float32)
    squares: np.ndarray = (left**2).sum(1)[:, None] + (right**2).sum(1) - 2 * (left @ right.T)
    return squares


def _nearest(distances2: np.ndarray) -> Integer[np.ndarray, " n"]:
    """Return each row's nearest neighbour, or -1 where Lowe's ratio test fails."""
    rows, best = np.arange(len(distances2)), distances2.argmin(axis=1)
    others = distances2.copy()
    others[rows, best] = np.inf
    return np.where(distances2[rows, best] < MAX_DISTANCE_RATIO**2 * others.min(axis=1), best, -1)


def _fits(
    first: View, x: Float64[np.ndarray, "m 2"], second: View, y: Float64[np.ndarray, "m 2"]
) -> Bool[np.ndarray, " m"]:
    """Return which pairs lie on each other's epipolar lines, to `MAX_EPIPOLAR_SHARE` of the photo's longer side."""
    fundamental = fundamental_matrix(first, second)
    homogeneous = [np.concatenate([points, np.ones((len(points), 1))], axis=1) for points in (x, y)]
    in_second, in_first = homogeneous[0] @ fundamental.T, homogeneous[1] @ fundamental
    residuals = np.abs((homogeneous[1] * in_second).sum(axis=1))
    fits = np.ones(len(x), bool)
    for lines, view in ((in_second, second), (in_first, first)):
        tolerance = MAX_EPIPOLAR_SHARE * max(view.width, view.height)
        fits &= residuals <= tolerance * np.linalg.norm(lines[:, :2], axis=1)
    return fits


def fundamental_matrix(first: View, second: View) -> Float64[np.ndarray, "3 3"]:
    """Return F with y^T F x = 0 for pixels x of the first and y of the second view that show one point.

    Source: Hartley and Zisserman, "Multiple View Geometry" (2004), Eq. 9.2.
    """
    relative = second.cam_from_world[:3, :3] @ first.cam_from_world[:3, :3].T
    x, y, z = second.cam_from_world[:3, :3] @ (first.center - second.center)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    essential = cross @ relative
    inverses = [np.linalg.inv(view.K) for view in (first, second)]
    return np.asarray(inverses[1].T @ essential @ inverses[0])
