"""How much of a scene pictures show, and which of many cameras show most of it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.sparse import csc_array

from ..arrays import Bool, Float64, Int64
from ..codes import Track, untracked
from ..embedding.view_choice import SIGHTS, greedy
from ..kernels import view_weights
from ..scene.views import View
from .space import MAX_NEAR_SHARE, Space

LONGER_SIDE = 252  # pixels of the pictures that are planned with
ENOUGH_PIXELS = 1.0  # blending weight of a Gaussian in a picture, summed over its pixels, that makes it seen there
SIGNIFICANT_WEIGHT = 0.98  # of all weight, each Gaussian counted by its best picture
OFTEN = int(SIGHTS)  # pictures
ENOUGH = 0.98  # share of what all candidates give together, at which as many pictures as it takes are enough
FEWEST_BY_DEFAULT, MOST_BY_DEFAULT = 48, 150
LARGE = 0.1  # of a picture's height: a Gaussian with a standard deviation of so much is a smear in it
SHARP_QUANTILE, SHARP_MARGIN = 0.1, 0.1  # cameras are sharp up to this quantile of all smears, and this above it


@dataclass(frozen=True)
class Coverage:
    """What pictures show of a scene.

    Attributes:
        significant: number of Gaussians that matter: those with the largest blending weights, by their best picture,
            which have 98 % of it together.
        often: share of these that three pictures or more show with a weight of a pixel or more.
        once: share of these that one picture or more shows.
        reachable: `often`, of all cameras that the choice was made from.
    """

    significant: int
    often: float
    once: float
    reachable: float

    def json(self) -> dict[str, object]:
        """Return the numbers as a record keeps them, with what they mean."""
        return {**asdict(self), "pictures": OFTEN, "pixels": ENOUGH_PIXELS}


@dataclass(frozen=True, eq=False)
class Sights:
    """What cameras see.

    Attributes:
        views: the cameras.
        pixels: blending weight of each Gaussian in each picture, in pixels, (N, V).
        smears: share of each picture that large Gaussians make up. From where no photo was taken a trained scene looks
            smeared.
    """

    views: list[View]
    pixels: csc_array
    smears: Float64[np.ndarray, " v"]

    def sharp(self) -> "Sights":
        """Return those that are hardly more smeared than the best tenth of them."""
        if not self.views:
            return self
        (kept,) = np.nonzero(self.smears <= np.quantile(self.smears, SHARP_QUANTILE) + SHARP_MARGIN)
        return Sights([self.views[at] for at in kept], csc_array(self.pixels[:, kept]), self.smears[kept])

    @property
    def significant(self) -> Bool[np.ndarray, " n"]:
        """Gaussians that have SIGNIFICANT_WEIGHT of all weight together, each counted by its best picture."""
        best = np.zeros(self.pixels.shape[0])
        np.maximum.at(best, self.pixels.indices, self.pixels.data)
        order = np.argsort(-best, kind="stable")
        before = np.cumsum(best[order]) - best[order]
        matters = np.zeros(len(best), np.bool_)
        matters[order] = (before < SIGNIFICANT_WEIGHT * best.sum()) & (best[order] > 0)
        return matters

    @property
    def seen(self) -> csc_array:
        """One for each Gaussian that matters and picture that shows enough of it, (M, V)."""
        seen = self.pixels.copy()
        seen.data = (seen.data >= ENOUGH_PIXELS).astype(np.float64)
        seen.eliminate_zeros()
        return csc_array(seen.tocsr()[np.flatnonzero(self.significant)].tocsc())

    def coverage(self, chosen: Sequence[int]) -> Coverage:
        """Measure what some of the pictures show."""
        seen = self.seen
        counts, every = _counts(seen, np.array(chosen, np.int64)), _counts(seen, np.arange(seen.shape[1]))
        if not len(counts):
            return Coverage(0, 0.0, 0.0, 0.0)
        often, once, reachable = ((counts >= OFTEN).mean(), (counts >= 1).mean(), (every >= OFTEN).mean())
        return Coverage(len(counts), float(often), float(once), float(reachable))


def sights(space: Space, views: Sequence[View], track: Track = untracked) -> Sights:
    """Look through some cameras, in small pictures; those with Gaussians right before them are left out."""
    ids, weights, smears, kept = [np.empty(0, np.int64)], [np.empty(0)], [], []
    sizes, positions = space.gaussians.scales.max(1), space.positions
    for view in track(views, "planning pictures"):
        small = view.limited(LONGER_SIDE)
        raster = np.zeros((small.height, small.width), np.int32)
        triples = view_weights(space.splats, small, raster, None, threads=space.threads)
        rows, seen = triples.gaussian_ids.astype(np.int64), triples.weights.astype(np.float64)
        if seen[space.is_near(view.center)[rows]].sum() > MAX_NEAR_SHARE * raster.size or not len(rows):
            continue
        away = positions[rows] @ view.cam_from_world[2, :3] + view.cam_from_world[2, 3]
        is_large = sizes[rows] * view.K[1, 1] > LARGE * view.height * away
        smears.append(seen[is_large].sum() / seen.sum())
        kept.append(view)
        ids.append(rows)
        weights.append(seen * (view.width * view.height / raster.size))
    starts = np.cumsum([len(some) for some in ids])
    shape = (len(space.gaussians), len(kept))
    pixels = csc_array((np.concatenate(weights), np.concatenate(ids), starts), shape=shape)
    return Sights(kept, pixels, np.array(smears))


def chosen_views(seen: Sights, number: int | None) -> list[int]:
    """Choose views one after another, each the one that shows most that was not seen in three pictures before.

    number: pictures; None for as many as bring coverage near to that of all, 48 to 150. When nothing is left to gain,
    all is to be seen three times more.
    """
    marks = seen.seen
    if number is None:
        enough = greedy(marks, ENOUGH, MOST_BY_DEFAULT)[0]
        number = max(len(enough), FEWEST_BY_DEFAULT)
    chosen: list[int] = []
    rest = np.arange(marks.shape[1])
    while len(chosen) < min(number, marks.shape[1]):
        more = greedy(csc_array(marks[:, rest]), 1.0, number - len(chosen))[0] or list(range(number - len(chosen)))
        chosen += rest[more[: len(rest)]].tolist()
        rest = np.setdiff1d(rest, chosen)
    return chosen


def _counts(seen: csc_array, chosen: Int64[np.ndarray, " c"]) -> Float64[np.ndarray, " m"]:
    """Return the number of pictures that show each Gaussian."""
    return np.asarray(seen[:, chosen].sum(axis=1)).reshape(-1)
