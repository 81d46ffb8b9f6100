"""Random points where no triangulated one stands: in the space that several cameras look into."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Bool, Float64
from ..scene.views import View

SEVERAL = 3  # cameras, or all where there are fewer
LEAST_SEEN = 10  # points that a view must see to know from them how far things are
REACH = (0.3, 1.5)  # of the distance of what a view looks at: nearer and farther is left empty
APART = 1.0  # median distances between the known points: a random one keeps it from them
BATCH, BATCHES = 1 << 15, 32

Ranges = Float64[np.ndarray, "v 2"]


def fill(
    views: Sequence[View], known: Float64[np.ndarray, "n 3"], count: int, rng: np.random.Generator, size: float
) -> Float64[np.ndarray, "m 3"]:
    """At most `count` places, drawn along random rays; fewer where cameras share little or no space.

    known: triangulated points, away from which they stay, and which say how far things are. size: of the scene,
    in its units, where neither points nor crossing lines of sight say it.
    """
    ranges = depth_ranges(views, known, size)
    apart = _apart(known)
    found: list[np.ndarray] = []
    missing = count
    for _ in range(BATCHES):
        drawn = _along_rays(views, ranges, rng)
        drawn = drawn[_seen_by_several(views, ranges, drawn)]
        if apart > 0 and len(drawn):
            drawn = drawn[cKDTree(known).query(drawn, workers=1)[0] > apart]
        found.append(drawn[:missing])
        missing -= len(found[-1])
        if missing == 0:
            break
    return np.concatenate(found)


def depth_ranges(views: Sequence[View], known: Float64[np.ndarray, "n 3"], size: float) -> Ranges:
    """From where to where each view is filled: about the points it sees, else about where all views look."""
    looked_at = _distances_to_focus(views, size)
    ranges = looked_at[:, None] * REACH
    for index, view in enumerate(views):
        depths = _depths_seen(view, known)
        if len(depths) >= LEAST_SEEN:
            low, high = np.percentile(depths, (5, 95))
            ranges[index] = low, high
    return ranges


def _distances_to_focus(views: Sequence[View], size: float) -> Float64[np.ndarray, " v"]:
    """Of each camera to the point nearest to all optical axes; `size` for those that it lies behind."""
    centers = np.array([view.center for view in views])
    axes = np.array([view.cam_from_world[2, :3] for view in views])
    middle = centers.mean(axis=0)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    sides = np.einsum("vij,vj->i", across, centers - middle)
    focus = np.linalg.lstsq(across.sum(axis=0), sides, rcond=1e-6)[0] + middle
    ahead: np.ndarray = ((focus - centers) * axes).sum(axis=1)
    distances: np.ndarray = np.where(ahead > 0.1 * size, ahead, size)
    return distances


def _depths_seen(view: View, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " m"]:
    pixels, depths = _projected(view, points)
    seen: np.ndarray = depths[_inside(view, pixels, depths)]
    return seen


def _along_rays(views: Sequence[View], ranges: Ranges, rng: np.random.Generator) -> Float64[np.ndarray, "b 3"]:
    """Of random views, random pixels and, in the range of the view, random depths."""
    chosen = rng.integers(len(views), size=BATCH)
    shares = rng.random((BATCH, 3))
    points = np.empty((BATCH, 3))
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
    """In the picture and the range of several views, and not right before any other."""
    times = np.zeros(len(points), np.int32)
    close = np.zeros(len(points), bool)
    for view, (low, high) in zip(views, ranges, strict=True):
        pixels, depths = _projected(view, points)
        inside = _inside(view, pixels, depths)
        times += inside & (depths >= low) & (depths <= high)
        close |= inside & (depths < 0.5 * low)
    return (times >= min(SEVERAL, len(views))) & ~close


def _projected(
    view: View, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    seen = (points - view.center) @ view.cam_from_world[:3, :3].T
    depths = seen[:, 2]
    safe = np.where(depths > 0, depths, 1.0)
    return (seen @ view.K.T)[:, :2] / safe[:, None], depths


def _inside(
    view: View, pixels: Float64[np.ndarray, "n 2"], depths: Float64[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    inside = (pixels >= 0).all(axis=1) & (pixels < (view.width, view.height)).all(axis=1)
    return inside & (depths > 0)


def _apart(known: Float64[np.ndarray, "n 3"]) -> float:
    """How far a random point keeps from the known ones; 0 where there are none."""
    if len(known) < 2:
        return 0.0
    nearest = cKDTree(known).query(known, k=2, workers=1)[0][:, 1]
    return APART * float(np.median(nearest))
