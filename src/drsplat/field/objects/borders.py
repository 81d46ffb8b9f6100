"""Borders of pieces: where they meet in the photos, and how far apart in depth they are there.

What is in front of something else ends in a jump of depth; where a surface goes on, depth does as well. So the borders
of pieces tell whether two of them are one surface of different colours, or one thing before another.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from ...base.arrays import Bool, Float32, Ids, Indices, Int32, Int64, MaskIds
from ...kernels import SplatArrays, heaviest_labels, render_channels, splat_arrays, topk_contributions
from ...scene.gaussians import Gaussians
from ...scene.views import View
from ..learning import drawn

OfPairs = Int64[np.ndarray, " p"]
OfPieces = Int64[np.ndarray, " k"]

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

Labels = MaskIds


class ViewBorders(NamedTuple):
    """Pairs of pieces that are side by side in one view, each once, as in `Borders`.

    pieces, areas: those that it shows, and their pixels.
    """

    pieces: OfPieces
    areas: OfPieces
    front: OfPairs
    back: OfPairs
    levels: OfPairs
    lengths: OfPairs


class Borders(NamedTuple):
    """Pairs of pieces that are side by side in some photo.

    front, back: the nearer piece and the further one. levels: pixels of their border where depth goes on. lengths: all
    pixels of it. areas: pixels of each piece.
    """

    front: Int32[np.ndarray, " p"]
    back: Int32[np.ndarray, " p"]
    levels: OfPairs
    lengths: OfPairs
    areas: Indices


def some_views(views: Iterable[View]) -> list[View]:
    """Return up to MAX_VIEWS views, which a hash of their names draws."""
    return sorted(views, key=lambda view: (drawn(view.name), view.name))[:MAX_VIEWS]


def borders(gaussians: Gaussians, views: Iterable[View], pieces: Ids, *, threads: int = 0) -> Borders:
    """Look at views. pieces: of each Gaussian, -1 for none.

    Memory is that of one view, and of the pairs. The same bits at any number of threads.
    """
    splats = splat_arrays(gaussians)
    found = (borders_in(splats, view, pieces, threads=threads) for view in views)
    return of_all_views(found, int(pieces.max(initial=NONE)) + 1)


def borders_in(splats: SplatArrays, view: View, pieces: Ids, *, threads: int = 0) -> ViewBorders:
    """Return the borders that a view shows. pieces: of each of the splats, -1 for none."""
    seen, labels, depth = _seen(splats, view.limited(MAX_SIDE_PIXELS), pieces, threads)
    shown, areas = np.unique(labels[labels >= 0], return_counts=True)
    pairs, counts = np.empty((2, 0), np.int64), np.empty((0, 2), np.int64)
    for front, back, jump in _crossings(labels, depth, float(seen.K[0, 0])):
        within = np.stack([jump < MIN_JUMP, np.ones(len(jump), bool)], axis=1)
        pairs = np.concatenate([pairs, np.stack([front, back]).astype(np.int64)], axis=1)
        counts = np.concatenate([counts, within.astype(np.int64)])
    most = int(shown.max(initial=NONE)) + 1
    keys, counts = _summed(pairs[0] * most + pairs[1], counts)
    front, back = np.divmod(keys, max(most, 1))
    return ViewBorders(shown.astype(np.int64), areas, front, back, counts[:, 0], counts[:, 1])


def of_all_views(found: Iterable[ViewBorders], count: int) -> Borders:
    """Return the borders of `count` pieces in some views together; whole numbers, in any order of the views."""
    areas = np.zeros(count, np.int64)
    keys, counts = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    for one in found:
        areas[one.pieces] += one.areas
        keys = np.concatenate([keys, one.front * count + one.back])
        keys, counts = _summed(keys, np.concatenate([counts, np.stack([one.levels, one.lengths], axis=1)]))
    front, back = (side.astype(np.int32) for side in np.divmod(keys, max(count, 1)))
    return Borders(front, back, counts[:, 0], counts[:, 1], areas)


def _summed(keys: OfPieces, counts: Int64[np.ndarray, "k 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Return each key once, its counts together."""
    once, places = np.unique(keys, return_inverse=True)
    total = np.zeros((len(once), counts.shape[1]), np.int64)
    np.add.at(total, places, counts)
    return once, total


def _seen(
    splats: SplatArrays, view: View, pieces: Ids, threads: int
) -> tuple[View, Labels, Float32[np.ndarray, "h w"]]:
    """Return the piece that each pixel shows most of, -1 for none, and its depth."""
    drawing = render_channels(splats, view, np.empty((len(pieces), 0), np.float32), threads=threads)
    most = heaviest_labels(
        topk_contributions(splats, view, GAUSSIANS_PER_PIXEL, threads=threads), pieces, threads=threads
    )
    return view, np.where(drawing.alpha < MIN_SEEN_OPACITY, NONE, most).astype(np.int32), drawing.depth


def _crossings(
    labels: Labels, depth: Float32[np.ndarray, "h w"], focal: float
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
        clear = _clear(shown, y, x)
        y, x = y[clear], x[clear]
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


def _clear(shown: Labels, y: OfPieces, x: OfPieces) -> Bool[np.ndarray, " k"]:
    """Mark places where both pieces are two pixels wide or more: slivers between others say nothing."""
    return np.asarray((shown[y, x - 1] == shown[y, x]) & (shown[y, x + 2] == shown[y, x + 1]))
