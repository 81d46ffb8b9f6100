"""Points of tracks: where the rays through a track's keypoints meet, if they do."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...base.arrays import Bool, Float64, Integer
from ...scene.views import View
from .tracks import Tracks

TOLERANCE_FACTORS = (16, 4, 1)  # by round: an outlier moves the first point off all rays
MAX_REPROJECTION_SHARE = 1 / 320  # of the photo's longer side; 2 pixels of 640
MIN_ANGLE_DEGREES = 1.5  # between the outermost rays and their middle; depth is a guess below
MIN_DETERMINANT = 1e-9


class Points(NamedTuple):
    """Triangulated points. tracks: the track of each. used: the observations that agree with their track's point."""

    positions: Float64[np.ndarray, "n 3"]
    tracks: Integer[np.ndarray, " n"]
    used: Bool[np.ndarray, " o"]


class _Rays(NamedTuple):
    """Rays by observation. centers: from the mean camera, so that a scene may lie far from its origin."""

    centers: Float64[np.ndarray, "o 3"]
    directions: Float64[np.ndarray, "o 3"]
    pixel: Float64[np.ndarray, " o"]  # tolerance as a slope: tolerated pixels over the focal length


def meet(views: Sequence[View], tracks: Tracks, pixels: Float64[np.ndarray, "o 2"], least: int) -> Points:
    """Triangulate each track, and return the points that at least `least` observations agree on.

    pixels: of each observation. In rounds of falling tolerance, observations that are off by more leave their track;
    the point then minimises the sum of squared distances to the rays, each over its depth.
    Source: the linear-Eigen triangulation's geometric twin, Hartley and Zisserman, Sec. 12.2; weights ours.
    """
    mean_center = np.mean([view.center for view in views], axis=0)
    rays = _rays(views, tracks.photos, pixels, mean_center)
    count = int(tracks.tracks.max(initial=-1)) + 1
    used, weights = np.ones(len(pixels), bool), np.ones(len(pixels))
    positions = np.zeros((count, 3))
    for factor in TOLERANCE_FACTORS:
        positions = _nearest_to_rays(rays, tracks.tracks, weights, count)
        depths, errors = _off(rays, positions[tracks.tracks])
        used = (depths > 0) & (errors <= factor * rays.pixel)
        weights = np.where(used, 1 / np.maximum(depths, MIN_DETERMINANT) ** 2, 0)
    positions = _nearest_to_rays(rays, tracks.tracks, weights, count)
    depths, errors = _off(rays, positions[tracks.tracks])
    used &= (depths > 0) & (errors <= rays.pixel)
    enough = np.bincount(tracks.tracks[used], minlength=count) >= least
    enough &= _angles(rays, tracks.tracks, used, count) >= np.radians(MIN_ANGLE_DEGREES)
    return Points(positions[enough] + mean_center, np.flatnonzero(enough), used)


def _rays(
    views: Sequence[View],
    photos: Integer[np.ndarray, " o"],
    pixels: Float64[np.ndarray, "o 2"],
    mean_center: Float64[np.ndarray, "3"],
) -> _Rays:
    homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
    to_world = np.array([view.cam_from_world[:3, :3].T @ np.linalg.inv(view.K) for view in views])
    directions = np.einsum("oij,oj->oi", to_world[photos], homogeneous)
    centers = np.array([view.center - mean_center for view in views])
    slopes = np.array([MAX_REPROJECTION_SHARE * max(v.width, v.height) / v.K[0, 0] for v in views])
    return _Rays(centers[photos], directions / np.linalg.norm(directions, axis=1, keepdims=True), slopes[photos])


def _nearest_to_rays(
    rays: _Rays, tracks: Integer[np.ndarray, " o"], weights: Float64[np.ndarray, " o"], count: int
) -> Float64[np.ndarray, "n 3"]:
    """Return each track's point nearest to its rays; NaN where they are parallel or all weights are 0."""
    across = np.eye(3) - rays.directions[:, :, None] * rays.directions[:, None, :]
    across *= weights[:, None, None]
    matrices = _summed(across.reshape(-1, 9), tracks, count).reshape(-1, 3, 3)
    sides = _summed(np.einsum("oij,oj->oi", across, rays.centers), tracks, count)
    scale = np.trace(matrices, axis1=1, axis2=2)
    solvable = np.linalg.det(matrices) > MIN_DETERMINANT * scale**3
    positions = np.full((count, 3), np.nan)
    positions[solvable] = np.linalg.solve(matrices[solvable], sides[solvable][..., None])[..., 0]
    return positions


def _off(
    rays: _Rays, positions: Float64[np.ndarray, "o 3"]
) -> tuple[Float64[np.ndarray, " o"], Float64[np.ndarray, " o"]]:
    """Return the depth of each point along its ray, and its distance from the ray over the depth (NaN stays)."""
    to_point = positions - rays.centers
    depths = (to_point * rays.directions).sum(axis=1)
    aside = np.linalg.norm(to_point - depths[:, None] * rays.directions, axis=1)
    return depths, aside / np.maximum(depths, MIN_DETERMINANT)


def _angles(
    rays: _Rays, tracks: Integer[np.ndarray, " o"], used: Bool[np.ndarray, " o"], count: int
) -> Float64[np.ndarray, " n"]:
    """Return each track's largest angle between a ray and the mean of all, in radians."""
    means = _summed(rays.directions * used[:, None], tracks, count)
    means /= np.maximum(np.linalg.norm(means, axis=1, keepdims=True), MIN_DETERMINANT)
    sines = np.linalg.norm(np.cross(rays.directions, means[tracks]), axis=1)
    largest = np.zeros(count)
    np.maximum.at(largest, tracks[used], np.arcsin(np.minimum(sines[used], 1)))
    return largest


def _summed(
    values: Float64[np.ndarray, "o c"], tracks: Integer[np.ndarray, " o"], count: int
) -> Float64[np.ndarray, "n c"]:
    """Sum values by track, in the order of the observations."""
    columns = [np.bincount(tracks, column, minlength=count) for column in values.T]
    return np.stack(columns, axis=1)
