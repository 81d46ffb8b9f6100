"""Coverage of a scene by pictures, and the choice of the cameras that show most of it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.sparse import csc_array

from ...base.arrays import Flags, Float64, Int64
from ...field.codes import Track, untracked
from ...kernels import view_weights
from ...photos.embedding.view_choice import SIGHTS_PER_GAUSSIAN, greedy
from ...scene.views import View
from .space import MAX_NEAR_SHARE, Space

PLANNING_SIDE_PIXELS = 252  # longer side of pictures for planning
ENOUGH_PIXELS = 1.0  # blending weight, summed over a picture's pixels, at which a Gaussian counts as seen
SIGNIFICANT_WEIGHT = 0.98  # of all weight, each Gaussian counted by its best picture
ENOUGH_SIGHTS = int(SIGHTS_PER_GAUSSIAN)  # of a Gaussian
ENOUGH_SHARE = 0.98  # of the coverage by all candidates, at which the default number of pictures is reached
DEFAULT_PICTURES_BOUNDS = (48, 150)
SMEAR_SHARE = 0.1  # of a picture's height: a Gaussian with a larger standard deviation is a smear
SHARP_QUANTILE, SHARP_MARGIN = 0.1, 0.1  # cameras are sharp up to this quantile of all smears, and this above it


@dataclass(frozen=True)
class Coverage:
    """Coverage of a scene by pictures.

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
        """Return the numbers for the record, with their definition."""
        return {**asdict(self), "pictures": ENOUGH_SIGHTS, "pixels": ENOUGH_PIXELS}


@dataclass(frozen=True, eq=False)
class Sights:
    """Sights of cameras: what each picture shows.

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
        """Return the sights of cameras hardly more smeared than the best tenth."""
        if not self.views:
            return self
        (sharp,) = np.nonzero(self.smears <= np.quantile(self.smears, SHARP_QUANTILE) + SHARP_MARGIN)
        return Sights([self.views[at] for at in sharp], csc_array(self.pixels[:, sharp]), self.smears[sharp])

    @property
    def significant(self) -> Flags:
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
        """Matrix with 1 where a picture shows enough of a Gaussian that matters, (M, V)."""
        seen = self.pixels.copy()
        seen.data = (seen.data >= ENOUGH_PIXELS).astype(np.float64)
        seen.eliminate_zeros()
        return csc_array(seen.tocsr()[np.flatnonzero(self.significant)].tocsc())

    def coverage(self, chosen: Sequence[int]) -> Coverage:
        """Measure the coverage by some of the pictures."""
        seen = self.seen
        counts, possible = _counts(seen, np.array(chosen, np.int64)), _counts(seen, np.arange(seen.shape[1]))
        if not len(counts):
            return Coverage(0, 0.0, 0.0, 0.0)
        often, reachable = ((numbers >= ENOUGH_SIGHTS).mean() for numbers in (counts, possible))
        once = (counts >= 1).mean()
        return Coverage(len(counts), float(often), float(once), float(reachable))


def sights(space: Space, views: Sequence[View], track: Track = untracked) -> Sights:
    """Look through cameras, in small pictures; cameras with Gaussians right before them are left out."""
    ids, weights, smears, accepted = [np.empty(0, np.int64)], [np.empty(0)], [], []
    sizes, positions = space.gaussians.scales.max(1), space.positions
    for view in track(views, "planning pictures"):
        small = view.limited(PLANNING_SIDE_PIXELS)
        raster = np.zeros((small.height, small.width), np.int32)
        triples = view_weights(space.splats, small, raster, None, threads=space.threads)
        rows, seen = triples.gaussian_ids.astype(np.int64), triples.weights.astype(np.float64)
        if seen[space.is_near(view.center)[rows]].sum() > MAX_NEAR_SHARE * raster.size or not len(rows):
            continue
        away = positions[rows] @ view.cam_from_world[2, :3] + view.cam_from_world[2, 3]
        is_large = sizes[rows] * view.K[1, 1] > SMEAR_SHARE * view.height * away
        smears.append(seen[is_large].sum() / seen.sum())
        accepted.append(view)
        ids.append(rows)
        weights.append(seen * (view.width * view.height / raster.size))
    starts = np.cumsum([len(row_ids) for row_ids in ids])
    shape = (len(space.gaussians), len(accepted))
    pixels = csc_array((np.concatenate(weights), np.concatenate(ids), starts), shape=shape)
    return Sights(accepted, pixels, np.array(smears))


def chosen_views(seen: Sights, number: int | None) -> list[int]:
    """Choose views one after another, each the one that shows most that is not yet in three pictures.

    number: pictures; None for as many as bring coverage near to that of all, 48 to 150. When nothing is left to gain,
    everything is to be seen three times more.
    """
    marks = seen.seen
    if number is None:
        enough = greedy(marks, ENOUGH_SHARE, DEFAULT_PICTURES_BOUNDS[1])[0]
        number = max(len(enough), DEFAULT_PICTURES_BOUNDS[0])
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
