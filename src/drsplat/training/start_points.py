"""Starting points of the Gaussians: given ones, else triangulated ones, else random ones."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Doubles, Flags, Float64, OtherPoints, Points
from ..errors import InputError, warn
from ..formats.captures import SparsePoints
from ..scene.views import View
from .settings import TrainingSettings
from .start import NEIGHBOURS, scene_extent
from .triangulation import triangulate

ENOUGH_POINTS = 300  # triangulated; with so many, random ones between them cost PSNR (docs/training.md)
DEFAULT_GREY = 128
MIN_AGREEING_SHARE = 0.15  # with right poses 0.4 and more agree, with wrong ones a few hundredths
MIN_ALIKE_MATCHES = 50  # for a verdict on the poses
MIN_CAMERAS = 3  # that look at a point; all of them if there are fewer
MIN_POINTS_IN_VIEW = 10  # for a view to take its depth range from them
DEPTHS_OVER_FOCUS_DISTANCE = (0.3, 1.5)  # random points lie between
CLEARANCE_IN_SPACINGS = 1.0  # of random points from triangulated ones, in median distances between those
BATCH_POINTS, MAX_BATCHES = 1 << 15, 32

Ranges = Float64[np.ndarray, "v 2"]


class Start(NamedTuple):
    """The points, of which the first `triangulated` were found in the photos, the last `random` drawn."""

    points: SparsePoints
    triangulated: int = 0
    random: int = 0

    def plain(self) -> dict[str, int]:
        """Return the points by where they come from, for JSON."""
        given = len(self.points.positions) - self.triangulated - self.random
        return {"given": given, "triangulated": self.triangulated, "random": self.random}


def start_points(
    points: SparsePoints | None,
    views: Sequence[View],
    settings: TrainingSettings,
    rng: np.random.Generator,
    *,
    threads: int = 0,
) -> Start:
    """Return the given points, thinned to the budget, or else those of `triangulate`.

    Where these are few, random ones in the space that several cameras look into are added.

    Warns: DrSplatWarning: few points, poses that do not fit the photos.
    Raises: InputError: points that are not finite, or too few of them.
    """
    if points is None or len(points.positions) == 0:
        start = _triangulated_start(views, settings, rng, threads)
    else:
        _check_points(points)
        start = Start(points)
    count, limit = len(start.points.positions), settings.max_gaussians
    if limit is None or count <= limit:
        return start
    kept = np.sort(rng.choice(count, max(limit, 1), replace=False))
    some = SparsePoints(start.points.positions[kept], start.points.colors[kept])
    return Start(some, int((kept < start.triangulated).sum()), int((kept >= count - start.random).sum()))


def _triangulated_start(
    views: Sequence[View], settings: TrainingSettings, rng: np.random.Generator, threads: int
) -> Start:
    found = triangulate(views, threads=threads)
    if found.alike >= MIN_ALIKE_MATCHES and found.agreeing < MIN_AGREEING_SHARE * found.alike:
        warn(
            f"only {found.agreeing:,} of {found.alike:,} matches between photos agree with their poses "
            f"({found.agreeing / found.alike:.1%}; of right poses, 40 % and more): check that the poses are of these "
            "photos, and the axes and lens of the file that they come from",
            5,
        )
    count = len(found.positions)
    if count >= ENOUGH_POINTS:
        return Start(SparsePoints(found.positions, found.colors), count)
    drawn = _random_places(views, found.positions, settings, rng)
    warn(
        f"triangulating {found.photos} photos gave {count:,} of the {ENOUGH_POINTS} points that would do (they show "
        f"little texture, or little of the same): training starts from {len(drawn):,} random points as well, where "
        "several cameras look, which takes longer and ends worse. Points of another tool can be given (points=FILE)",
        5,
    )
    positions = np.concatenate([found.positions, drawn])
    grey = np.full(drawn.shape, DEFAULT_GREY, np.uint8)
    return Start(SparsePoints(positions, np.concatenate([found.colors, grey])), count, len(drawn))


def _random_places(
    views: Sequence[View], known: Points, settings: TrainingSettings, rng: np.random.Generator
) -> OtherPoints:
    """Draw places in the space that several cameras see; where there is none, in the cube about the cameras."""
    count = settings.random_points
    if settings.max_gaussians is not None:
        count = max(min(count, settings.max_gaussians) - len(known), 0)
    extent = scene_extent(views)
    drawn = fill(views, known, count, rng, extent)
    if len(drawn) + len(known) > NEIGHBOURS:
        return drawn
    middle: np.ndarray = np.mean([view.center for view in views], axis=0)
    return middle + rng.uniform(-extent, extent, (max(count, NEIGHBOURS + 1), 3))


def _check_points(points: SparsePoints) -> None:
    count = len(points.positions)
    if points.positions.shape != (count, 3) or points.colors.shape != (count, 3):
        raise InputError(
            f"points: expected positions and colors (n, 3), got {points.positions.shape} and {points.colors.shape}"
        )
    finite: Flags = np.isfinite(points.positions).all(1)
    if not finite.all():
        raise InputError(
            f"{count - int(finite.sum())} of {count} points are not finite, the first at index "
            f"{int(np.argmin(finite))}: remove them, or pass no points to triangulate others"
        )
    if count <= NEIGHBOURS:
        raise InputError(
            f"{count} points are too few: sizes come from the {NEIGHBOURS} nearest neighbours. Pass "
            "no points to triangulate others, or pose the photos again"
        )


def fill(views: Sequence[View], triangulated: Points, count: int, rng: np.random.Generator, size: float) -> OtherPoints:
    """Draw at most `count` points along random rays; fewer where cameras share little or no space.

    triangulated: points that random ones keep away from, and take their depths from. size: of the scene,
    in its units, used where neither points nor crossing lines of sight give a depth.
    """
    # the depths between which each view is filled: about its points, else about the point all views look at
    looked_at = _distances_to_focus(views, size)
    ranges = looked_at[:, None] * DEPTHS_OVER_FOCUS_DISTANCE
    for index, view in enumerate(views):
        inside, depths = _seen(view, triangulated)
        depths = depths[inside]
        if len(depths) >= MIN_POINTS_IN_VIEW:
            low, high = np.percentile(depths, (5, 95))
            ranges[index] = low, high
    clearance = 0.0  # in scene units
    if len(triangulated) > 1:
        nearest = cKDTree(triangulated).query(triangulated, k=2, workers=1)[0][:, 1]
        clearance = CLEARANCE_IN_SPACINGS * float(np.median(nearest))
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


def _distances_to_focus(views: Sequence[View], size: float) -> Doubles:
    """Return each camera's distance to the point nearest to all optical axes; `size` if it is not ahead."""
    centers = np.array([view.center for view in views])
    axes = np.array([view.cam_from_world[2, :3] for view in views])
    mean_center = centers.mean(0)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    sides = np.einsum("vij,vj->i", across, centers - mean_center)
    focus = np.linalg.lstsq(across.sum(0), sides, rcond=1e-6)[0] + mean_center
    ahead: np.ndarray = ((focus - centers) * axes).sum(1)
    return np.where(ahead > 0.1 * size, ahead, size)


def _along_rays(views: Sequence[View], ranges: Ranges, rng: np.random.Generator) -> Points:
    """Draw points at random depths, in the view's range, through random pixels of random views."""
    chosen = rng.integers(len(views), size=BATCH_POINTS)
    shares = rng.random((BATCH_POINTS, 3))
    points = np.empty((BATCH_POINTS, 3))
    for index, view in enumerate(views):
        rows = chosen == index
        pixels = shares[rows, :2] * view.size
        low, high = ranges[index]
        depths = low + shares[rows, 2] * (high - low)
        rays = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ np.linalg.inv(view.K).T
        points[rows] = (rays * depths[:, None]) @ view.cam_from_world[:3, :3] + view.center
    return points


def _seen_by_several(views: Sequence[View], ranges: Ranges, points: Points) -> Flags:
    """Return which points several views see in their range and no view sees right before it."""
    num_views = np.zeros(len(points), np.int32)
    is_close = np.zeros(len(points), bool)
    for view, (low, high) in zip(views, ranges, strict=True):
        inside, depths = _seen(view, points)
        num_views += inside & (depths >= low) & (depths <= high)
        is_close |= inside & (depths < 0.5 * low)
    return (num_views >= min(MIN_CAMERAS, len(views))) & ~is_close


def _seen(view: View, points: Points) -> tuple[Flags, Doubles]:
    """Return which points lie in the view's picture, and the depths (camera z) of all."""
    in_camera = (points - view.center) @ view.cam_from_world[:3, :3].T
    depths = in_camera[:, 2]
    pixels = (in_camera @ view.K.T)[:, :2] / np.where(depths > 0, depths, 1.0)[:, None]
    return (pixels >= 0).all(1) & (pixels < view.size).all(1) & (depths > 0), depths
