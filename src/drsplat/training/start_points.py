"""Starting points of the Gaussians: given ones, else triangulated ones, else random ones."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arrays import Bool, Float64
from ..errors import DrSplatWarning, InputError
from ..formats.captures import SparsePoints
from ..scene.views import View
from .settings import TrainingSettings
from .start import NEIGHBOURS, scene_extent
from .triangulation import Triangulation, triangulate
from .triangulation.filling import fill

ENOUGH_POINTS = 300  # triangulated; with so many, random ones between them cost PSNR (bench_starts.py)
DEFAULT_GREY = 128
MIN_AGREEING_SHARE = 0.15  # with right poses 0.4 and more agree, with wrong ones a few hundredths
MIN_ALIKE_MATCHES = 50  # for a verdict on the poses


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
        return _thinned(_triangulated_start(views, settings, rng, threads), settings, rng)
    _check_points(points)
    return _thinned(Start(points), settings, rng)


def _triangulated_start(
    views: Sequence[View], settings: TrainingSettings, rng: np.random.Generator, threads: int
) -> Start:
    found = triangulate(views, threads=threads)
    _warn_of_wrong_poses(found)
    count = len(found.positions)
    if count >= ENOUGH_POINTS:
        return Start(SparsePoints(found.positions, found.colors), count)
    drawn = _random_places(views, found.positions, settings, rng)
    warnings.warn(
        f"triangulating {found.photos} photos gave {count:,} of the {ENOUGH_POINTS} points that would do (they show "
        f"little texture, or little of the same): training starts from {len(drawn):,} random points as well, where "
        "several cameras look, which takes longer and ends worse. Points of another tool can be given (points=FILE)",
        DrSplatWarning,
        stacklevel=5,
    )
    positions = np.concatenate([found.positions, drawn])
    grey = np.full(drawn.shape, DEFAULT_GREY, np.uint8)
    return Start(SparsePoints(positions, np.concatenate([found.colors, grey])), count, len(drawn))


def _random_places(
    views: Sequence[View], known: Float64[np.ndarray, "n 3"], settings: TrainingSettings, rng: np.random.Generator
) -> Float64[np.ndarray, "m 3"]:
    """Draw places in the space that several cameras see; where there is none, in the cube about the cameras."""
    count = settings.random_points
    if settings.max_gaussians is not None:
        count = max(min(count, settings.max_gaussians) - len(known), 0)
    extent = scene_extent(views)
    drawn = fill(views, known, count, rng, extent)
    least = NEIGHBOURS + 1
    if len(drawn) + len(known) >= least:
        return drawn
    middle: np.ndarray = np.mean([view.center for view in views], axis=0)
    cube: np.ndarray = middle + rng.uniform(-extent, extent, (max(count, least), 3))
    return cube


def _warn_of_wrong_poses(found: Triangulation) -> None:
    if found.alike < MIN_ALIKE_MATCHES or found.agreeing >= MIN_AGREEING_SHARE * found.alike:
        return
    warnings.warn(
        f"only {found.agreeing:,} of {found.alike:,} matches between photos agree with their poses "
        f"({found.agreeing / found.alike:.1%}; of right poses, 40 % and more): check that the poses are of these "
        "photos, and the axes and lens of the file that they come from",
        DrSplatWarning,
        stacklevel=6,
    )


def _thinned(start: Start, settings: TrainingSettings, rng: np.random.Generator) -> Start:
    count, limit = len(start.points.positions), settings.max_gaussians
    if limit is None or count <= limit:
        return start
    kept = np.sort(rng.choice(count, max(limit, 1), replace=False))
    points = SparsePoints(start.points.positions[kept], start.points.colors[kept])
    triangulated = int((kept < start.triangulated).sum())
    random = int((kept >= count - start.random).sum())
    return Start(points, triangulated, random)


def _check_points(points: SparsePoints) -> None:
    count = len(points.positions)
    if points.positions.shape != (count, 3) or points.colors.shape != (count, 3):
        raise InputError(
            f"points: expected positions and colors (n, 3), got {points.positions.shape} and {points.colors.shape}"
        )
    finite: Bool[np.ndarray, " n"] = np.isfinite(points.positions).all(axis=1)
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
