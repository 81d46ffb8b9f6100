"""Borders of pieces: where they meet in the photos, and how far apart in depth they are there.

What is in front of something else ends in a jump of depth; where a surface goes on, depth does as well. So the borders
of pieces tell whether two of them are one surface of different colours, or one thing before another.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...base.arrays import Arrays, Ids, Indices, MaskIds, OtherIndices, PixelNumbers, Spans
from ...base.working import Held, Here, Work
from ...kernels import SplatArrays, heaviest_labels, render_channels, topk_contributions
from ...scene.gaussians import Gaussians
from ...scene.views import View
from ..evidence.columns import Scenery, StillScenery
from ..learning import drawn

MAX_SIDE_PIXELS = 336  # of a photo: borders need no more
MAX_VIEWS = 60
GAUSSIANS_PER_PIXEL = 8  # the heaviest
MIN_SEEN_OPACITY = 0.5  # of a pixel that shows something
MIN_JUMP = 1.5  # of depth, in what STRIDE_PIXELS are across there: below it depth goes on
FAR_JUMP = 2.0  # from which on a border is never a valley
STRIDE_PIXELS = 5  # between the depths on both sides: nearer ones are mixtures of both
REACH_PIXELS = 8  # from the border to the far end of a slope
MAX_BEND = 1.0  # between the slopes on both sides, away from the camera: a mug's foot on a table, the corner of a room
NONE = -1


class Borders(NamedTuple):
    """Pairs of pieces that are side by side in some photo.

    front, back: the nearer piece and the further one. levels: pixels of their border where depth goes on. lengths: all
    pixels of it. areas: pixels of each piece.
    """

    front: Ids
    back: Ids
    levels: Indices
    lengths: Indices
    areas: OtherIndices


def some_views(views: Iterable[View]) -> list[View]:
    """Return up to MAX_VIEWS views, which a hash of their names draws."""
    return sorted(views, key=lambda view: (drawn(view.name), view.name))[:MAX_VIEWS]


def borders(
    gaussians: Gaussians, views: Sequence[View], pieces: Ids, *,
    threads: int = 0, scenery: Scenery | None = None, work: Work | None = None,
) -> Borders:  # fmt: skip
    """Look at views. The same bits at any number of threads, and in any order of the views.

    Args:
        gaussians: the scene.
        views: of which one is drawn at a time.
        pieces: of each Gaussian, -1 for none.
        threads: 0 for all cores.
        scenery: what the cameras see; None: the Gaussians.
        work: who looks; None: this process.
    """
    work, count = work or Here(threads), int(pieces.max(initial=NONE)) + 1
    bordering = Bordering(scenery or StillScenery(gaussians), work.hold({"pieces": pieces}))
    areas = np.zeros(count, np.int64)
    keys, counts = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    for held in work(bordering, views, "looking at borders"):
        one = held.arrays
        areas[one["pieces"]] += one["areas"]
        keys = np.concatenate([keys, one["front"] * count + one["back"]])
        keys, counts = _summed(keys, np.concatenate([counts, one["counts"]]))
    front, back = (side.astype(np.int32) for side in np.divmod(keys, max(count, 1)))
    return Borders(front, back, counts[:, 0], counts[:, 1], areas)


@dataclass(frozen=True, eq=False)
class Bordering:
    """Finds the pieces that a view shows, their areas, and the pairs that are side by side in it: a `Part`."""

    scenery: Scenery
    pieces: Held

    def __call__(self, view: View, threads: int) -> Arrays:
        (splats, rows), pieces = self.scenery.visible_splats(view), self.pieces.arrays["pieces"]
        seen = view.limited(MAX_SIDE_PIXELS)
        labels, depth = _seen(splats, seen, np.asarray(pieces if rows is None else pieces[rows]), threads)
        shown, areas = np.unique(labels[labels >= 0], return_counts=True)
        fronts, backs, jumps = (
            np.concatenate(both) for both in zip(*_crossings(labels, depth, float(seen.K[0, 0])), strict=True)
        )
        most = int(shown.max(initial=0)) + 1
        counts = np.stack([jumps < MIN_JUMP, np.ones(len(jumps), bool)], axis=1).astype(np.int64)
        keys, counts = _summed(fronts.astype(np.int64) * most + backs, counts)
        front, back = np.divmod(keys, most)
        return {"pieces": shown.astype(np.int64), "areas": areas, "front": front, "back": back, "counts": counts}


def _summed(keys: Indices, counts: Spans) -> tuple[np.ndarray, np.ndarray]:
    """Return each key once, its counts together."""
    once, places = np.unique(keys, return_inverse=True)
    total = np.zeros((len(once), counts.shape[1]), np.int64)
    np.add.at(total, places, counts)
    return once, total


def _seen(splats: SplatArrays, view: View, pieces: Ids, threads: int) -> tuple[MaskIds, PixelNumbers]:
    """Return the piece that each pixel shows most of, -1 for none, and its depth."""
    drawing = render_channels(splats, view, np.empty((len(pieces), 0), np.float32), threads=threads)
    most = heaviest_labels(
        topk_contributions(splats, view, GAUSSIANS_PER_PIXEL, threads=threads), pieces, threads=threads
    )
    return np.where(drawing.alpha < MIN_SEEN_OPACITY, NONE, most).astype(np.int32), drawing.depth


def _crossings(
    labels: MaskIds, depth: PixelNumbers, focal: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the pairs of neighbouring pixels of two pieces, along rows and then along columns.

    The nearer piece, the further one, and the jump between them in what STRIDE_PIXELS are across there. Of a slanted
    surface depth changes without any jump: both sides are prolonged to the border, and the smaller difference counts.
    Where depth goes on, but in a valley, two things touch: such pixels are left out.
    """
    for shown, far in ((labels, depth), (labels.T, depth.T)):
        left, right = shown[:, REACH_PIXELS + 1 : -REACH_PIXELS - 2], shown[:, REACH_PIXELS + 2 : -REACH_PIXELS - 1]
        y, x = np.nonzero((left != right) & (left >= 0) & (right >= 0))
        x = x + REACH_PIXELS + 1
        wide = (shown[y, x - 1] == shown[y, x]) & (shown[y, x + 2] == shown[y, x + 1])  # slivers say nothing
        y, x = y[wide], x[wide]
        before, after = far[y, x - 2], far[y, x + 3]
        slopes = (before - far[y, x - 5]) / 3, (far[y, x + 6] - after) / 3
        prolonged = np.abs(before + 2.5 * slopes[0] - (after - 2.5 * slopes[1]))
        pixel = np.minimum(before, after) / focal
        jump = np.minimum(np.abs(before - after), prolonged) / (STRIDE_PIXELS * pixel)
        bend = (before - far[y, x - REACH_PIXELS] - far[y, x + REACH_PIXELS + 1] + after) / ((REACH_PIXELS - 2) * pixel)
        kept = (bend <= MAX_BEND) | (jump >= FAR_JUMP)
        y, x, jump, nearer = y[kept], x[kept], jump[kept], (before < after)[kept]
        one, other = shown[y, x], shown[y, x + 1]
        yield np.where(nearer, one, other), np.where(nearer, other, one), jump
