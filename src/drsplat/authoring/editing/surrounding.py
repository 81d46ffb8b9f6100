"""Places that points surround: those with points in nearly all directions, of many places at once.

Directions from a place to 1,500 points fall into 64 bins, and computing all of that for each of a million places takes
minutes. Places of one box see most points in the same bins, so boxes are halved only where that leaves the answer open.
"""

import numpy as np

from ...base.arrays import Bool, Flags, Float64, Indices

MAX_LEAF_PLACES = 4  # of a box in which each place is computed
RELATIVE_ROUNDING = 1e-12  # more than what products of three numbers are off
Points = Float64[np.ndarray, "t 3"]
Directions = Float64[np.ndarray, "d 3"]
Places = Float64[np.ndarray, "n 3"]
Hit = Bool[np.ndarray, " d"]  # of each direction


def surrounded(places: Places, points: Points, directions: Directions, min_bins: int) -> Flags:
    """Return the places from which points lie in at least `min_bins` of the bins.

    The bin of a point, seen from a place, is the nearest of `directions`, and the first of several. The result is the
    same as that of comparing every place with every point.
    """
    result = np.zeros(len(places), bool)
    apart = np.abs(directions[:, None] - directions[None])
    boxes = [(np.arange(len(places)), points, np.zeros(len(directions), bool))] if len(places) else []
    while boxes:
        rows, open_points, hit = boxes.pop()
        here = places[rows]
        if len(rows) <= MAX_LEAF_PLACES:
            result[rows] = _bins(here, open_points, directions, hit) >= min_bins
            continue
        open_points, hit, reachable = _in_box(here, open_points, directions, apart, hit)
        if hit.sum() >= min_bins:
            result[rows] = True
        elif reachable.sum() >= min_bins:
            # halves, cut across the longest side
            order = np.argpartition(here[:, np.ptp(here, axis=0).argmax()], len(rows) // 2)
            boxes += [(rows[half], open_points, hit) for half in np.array_split(order, [len(rows) // 2])]
    return result


def _in_box(
    places: Places, points: Points, directions: Directions, apart: Float64[np.ndarray, "d d 3"], hit: Hit
) -> tuple[Float64[np.ndarray, "o 3"], Hit, Hit]:
    """Return the points that may fall into further bins, the bins that all places hit, and those that any may hit.

    hit: bins that all places are known to hit. apart: differences of all pairs of directions, without signs.
    """
    low, high = places.min(0), places.max(0)
    away = points - (low + high) / 2
    scores = away @ directions.T
    nearest = scores.argmax(1)
    rounding = RELATIVE_ROUNDING * (np.abs(away).sum(1) + np.abs(low).sum() + np.abs(high).sum())
    # from the middle of the box to a place, the score of a direction gains on another's at most what the box allows
    gains = (apart @ ((high - low) / 2))[nearest]
    possible = scores + gains >= (scores.max(1) - rounding)[:, None]
    certain = possible.sum(1) == 1
    hit = hit.copy()
    hit[nearest[certain]] = True
    open_ = ~certain & possible[:, ~hit].any(1)
    return points[open_], hit, hit | possible[open_].any(0)


def _bins(places: Places, points: Points, directions: Directions, hit: Hit) -> Indices:
    """Return how many bins each place hits, with those that it is known to hit."""
    away = points[None] - places[:, None]
    nearest = np.einsum("pti,di->ptd", away, directions).argmax(2)
    hits = np.tile(hit, (len(places), 1))
    np.put_along_axis(hits, nearest, True, axis=1)
    return hits.sum(1)
