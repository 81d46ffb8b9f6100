"""Random points in space that several cameras look into and no triangulated point fills."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ...base.arrays import Bool, Float64
from ...scene.views import View

MIN_CAMERAS = 3  # that look at a point; all of them if there are fewer
MIN_POINTS_IN_VIEW = 10  # for a view to take its depth range from them
DEPTHS_OVER_FOCUS_DISTANCE = (0.3, 1.5)  # random points lie between
CLEARANCE_IN_SPACINGS = 1.0  # of random points from triangulated ones, in median distances between those
BATCH_POINTS, MAX_BATCHES = 1 << 15, 32

Ranges = Float64[np.ndarray, "v 2"]


def fill(
    views: Sequence[View], triangulated: Float64[np.ndarray, "n 3"], count: int, rng: np.random.Generator, size: float
) -> Float64[np.ndarray, "m 3"]:
    """Draw at most `count` points along random rays; fewer where cameras share little or no space.

    triangulated: points that random ones keep away from, and take their depths from. size: of the scene,
    in its units, used where neither points nor crossing lines of sight give a depth.
    """
    ranges = depth_ranges(views, triangulated, size)
    clearance = _clearance(triangulated)
    batches: list[np.ndarray] = []
    missing = count
    for _ in range(MAX_BATCHES):
        drawn = _along_rays(views, ranges, rng)
        drawn = drawn[_seen_by_several(views, ranges, drawn)]
        if clearance > 0 and len(drawn):
            drawn = drawn[cKDTree(triangulated).query(drawn, workers=1)[0] > clearance]
        batches.append(drawn[:missing])
        missing -= len(batches[-1])
        if missing == 0:
            break
    return np.concatenate(batches)


def depth_ranges(views: Sequence[View], triangulated: Float64[np.ndarray, "n 3"], size: float) -> Ranges:
    """Return the depths between which each view is filled: about its points, else about the point all views look at."""
    looked_at = _distances_to_focus(views, size)
    ranges = looked_at[:, None] * DEPTHS_OVER_FOCUS_DISTANCE
    for index, view in enumerate(views):
        depths = _depths_seen(view, triangulated)
        if len(depths) >= MIN_POINTS_IN_VIEW:
            low, high = np.percentile(depths, (5, 95))
            ranges[index] = low, high
    return ranges


def _distances_to_focus(views: Sequence[View], size: float) -> Float64[np.ndarray, " v"]:
    """Return each camera's distance to the point nearest to all optical axes; `size` if it is not ahead."""
    centers = np.array([view.center for view in views])
    axes = np.array([view.cam_from_world[2, :3] for view in views])
    mean_center = centers.mean(axis=0)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    sides = np.einsum("vij,vj->i", across, centers - mean_center)
    focus = np.linalg.lstsq(across.sum(axis=0), sides, rcond=1e-6)[0] + mean_center
    ahead: np.ndarray = ((focus - centers) * axes).sum(axis=1)
    distances: np.ndarray = np.where(ahead > 0.1 * size, ahead, size)
    return distances


def _depths_seen(view: View, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " m"]:
    pixels, depths = _projected(view, points)
    seen: np.ndarray = depths[_inside(view, pixels, depths)]
    return seen


def _along_rays(views: Sequence[View], ranges: Ranges, rng: np.random.Generator) -> Float64[np.ndarray, "b 3"]:
    """Draw points at random depths, in the view's range, through random pixels of random views."""
    chosen = rng.integers(len(views), size=BATCH_POINTS)
    shares = rng.random((BATCH_POINTS, 3))
    points = np.empty((BATCH_POINTS, 3))
    for index, view in enumerate(views):
        rows = chosen == index
        pixels = shares[rows, :2] * (view.width, view.height)
        low, high = ranges[index]
        depths = low + shares[rows, 2] * (high - low)
        rays = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ np.linalg.inv(view.K).T
        points[rows] = (rays * depths[:, None]) @ view.cam_from_world[:3, :3] + view.center
    return points


def _seen_by_several(
    views: Sequence[View], ranges: Ranges, points: Float64[np.ndarray, "b 3"]
) -> Bool[np.ndarray, " b"]:
    """Return which points several views see in their range and no view sees right before it."""
    num_views = np.zeros(len(points), np.int32)
    is_close = np.zeros(len(points), bool)
    for view, (low, high) in zip(views, ranges, strict=True):
        pixels, depths = _projected(view, points)
        inside = _inside(view, pixels, depths)
        num_views += inside & (depths >= low) & (depths <= high)
        is_close |= inside & (depths < 0.5 * low)
    return (num_views >= min(MIN_CAMERAS, len(views))) & ~is_close


def _projected(
    view: View, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Return the pixels and depths (camera z) of points. Pixels of points behind the camera are meaningless."""
    in_camera = (points - view.center) @ view.cam_from_world[:3, :3].T
    depths = in_camera[:, 2]
    safe = np.where(depths > 0, depths, 1.0)
    return (in_camera @ view.K.T)[:, :2] / safe[:, None], depths


def _inside(
    view: View, pixels: Float64[np.ndarray, "n 2"], depths: Float64[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    inside = (pixels >= 0).all(axis=1) & (pixels < (view.width, view.height)).all(axis=1)
    return inside & (depths > 0)


def _clearance(triangulated: Float64[np.ndarray, "n 3"]) -> float:
    """Return how far random points stay from triangulated ones, in scene units; 0 for fewer than two."""
    if len(triangulated) < 2:
        return 0.0
    nearest = cKDTree(triangulated).query(triangulated, k=2, workers=1)[0][:, 1]
    return CLEARANCE_IN_SPACINGS * float(np.median(nearest))
