"""Greedy choice of the photos that suffice to see everything that matters often enough.

Scene and poses are known before any mask is made, so the visible part of each photo is, too.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array

from ...base.arrays import Doubles, WholeNumbers
from ...field.codes import Track, untracked
from ...field.evidence.aggregation import Sampling
from ...field.evidence.columns import scenery_of
from ...scene.gaussians import Gaussians
from ...scene.views import View

SIGHTS_PER_GAUSSIAN = 3.0
"""Sum over photos, of a Gaussian's weight over that in its best photo, from which it is seen often enough."""
ENOUGH_SHARE = 0.98
"""Share of the score of all photos together."""
LONGER_SIDE_PIXELS = 252
"""Pixels of the longer side of photos in this choice, which needs visibility alone."""


@dataclass(frozen=True, eq=False)
class ViewChoice:
    """Photos in the order of choice, and the share of the scene seen after each.

    Attributes:
        views: the chosen ones.
        seen: share of what all photos show that has been seen often enough, after each of them.
    """

    views: list[View]
    seen: list[float]


def choose_views(
    gaussians: Gaussians,
    views: Sequence[View],
    *,
    enough: float = ENOUGH_SHARE,
    most: int | None = None,
    threads: int = 0,
    track: Track = untracked,
) -> ViewChoice:
    """Choose views greedily until Gaussians have been seen often enough.

    Every Gaussian needs SIGHTS_PER_GAUSSIAN sights. The photo in which it has most weight counts as one sight, another
    as its weight there over that one: what is large in a photo gets better masks than what is far. All Gaussians count
    the same, since Gaussians are dense where detail is. What photos show together has diminishing returns
    (submodular), so the greedy choice is within 1 - 1/e of the best one of its length.

    Args:
        gaussians: the scene, which stands still.
        views: the cameras; photos are not opened.
        enough: share of the score of all views at which the choice ends.
        most: views at most; None for as many as it takes.
        threads: 0 for all cores; the result does not depend on it.
        track: shows progress.

    Source: Nemhauser, Wolsey and Fisher 1978; evaluated lazily as by Minoux 1978.
    """
    sights = _sights(gaussians, views, threads, track)
    order, seen = greedy(sights, enough, len(views) if most is None else most)
    return ViewChoice([views[number] for number in order], seen)


def _sights(gaussians: Gaussians, views: Sequence[View], threads: int, track: Track) -> csc_array:
    """Return how much of a sight each view is of each Gaussian, (N, V), up to 1."""
    scenery, sampling = scenery_of(gaussians), Sampling()
    ids, weights = [np.empty(0, np.int64)], [np.empty(0)]
    for view in track(views, "looking at what photos show"):
        small = replace(view, distortion=None).limited(LONGER_SIDE_PIXELS)
        everything = np.zeros((small.height, small.width), np.int32)
        triples = sampling.triples(scenery.visible_splats(small).splats, small, everything, threads)
        ids.append(triples.gaussian_ids.astype(np.int64))
        weights.append(triples.weights.astype(np.float64))
    starts = np.cumsum([len(row_ids) for row_ids in ids])
    data, rows = np.concatenate(weights), np.concatenate(ids)
    best = np.zeros(len(gaussians))
    np.maximum.at(best, rows, data)
    return csc_array((data / best[rows], rows, starts), shape=(len(gaussians), len(views)))


def greedy(sights: csc_array, enough: float, most: int) -> tuple[list[int], list[float]]:
    """Return the views in order, and the share of the score of all of them after each.

    sights: how much of a sight each view is of each Gaussian, (N, V). enough: share of that score at which the choice
    ends. most: views at most.
    """
    have = np.zeros(sights.shape[0])

    def rows_and_sights(view: int) -> tuple[WholeNumbers, Doubles]:
        own = slice(*sights.indptr[view : view + 2])
        return sights.indices[own], sights.data[own]

    def gain(view: int) -> float:
        rows, added = rows_and_sights(view)
        return float(
            (np.minimum(have[rows] + added, SIGHTS_PER_GAUSSIAN) - np.minimum(have[rows], SIGHTS_PER_GAUSSIAN)).sum()
        )

    total = float(np.minimum(sights.sum(1), SIGHTS_PER_GAUSSIAN).sum())
    waiting = [(-gain(view), view) for view in range(sights.shape[1])]
    heapq.heapify(waiting)
    order: list[int] = []
    seen: list[float] = []
    score = 0.0
    while waiting and len(order) < most and score < enough * total:
        _, view = heapq.heappop(waiting)
        current = gain(view)  # gains only fall, so the first that is still first is the best
        if waiting and -current > waiting[0][0]:
            heapq.heappush(waiting, (-current, view))
            continue
        rows, added = rows_and_sights(view)
        have[rows] += added
        score += current
        order.append(view)
        seen.append(score / total)
    return order, seen
