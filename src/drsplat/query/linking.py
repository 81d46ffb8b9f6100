"""Points that hang together, by the distances between them."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..base.arrays import DoubleRows, Indices, Int64, OtherIndices, Points, WholeNumbers
from ..scene.boxes import solid
from ..scene.parted import AnyGaussians
from .answer import Match

NUM_NEIGHBOURS = 8
MIN_NEAR_SHARE = 0.5  # of what is joined to an object as its border
LINK_FACTOR = 3.0  # links of up to this many typical spacings hold a thing together
TOUCH_FACTOR, MIN_TOUCHING_SHARE = 2.0, 0.1  # spacings between what touches, and how much of the smaller does


def components(points: Points, link_distance: float | None) -> Indices:
    """Label each point: those joined by steps of at most the link distance (None: typical spacings) share a label."""
    k = min(NUM_NEIGHBOURS, len(points) - 1)
    distances, neighbours = cKDTree(points).query(points, k=k + 1)
    reach = link_distance or _reach(distances)
    near = distances[:, 1:] <= reach
    source = np.broadcast_to(np.arange(len(points))[:, None], near.shape)[near]
    labels = _connected(len(points), source, neighbours[:, 1:][near])
    return _join_near_parts(points, labels, reach)[labels]


def join_to_held(
    places: Indices, points: Points, loose: OtherIndices,
    held: Int64[np.ndarray, " h"], link_distance: float | None,
) -> None:  # fmt: skip
    """Give loose places of which half lies at an object that was selected as well its number: they are its border."""
    tree = cKDTree(points[held])
    distances, nearest = tree.query(points[loose])
    among = min(NUM_NEIGHBOURS, len(held) - 1) + 1
    near = distances <= (link_distance or _reach(tree.query(points[held], among)[0]))
    _, component = np.unique(places[loose], return_inverse=True)
    share = np.bincount(component, near) / np.bincount(component)
    joins = near & (share[component] >= MIN_NEAR_SHARE)
    for number in np.unique(component[joins]):
        of = np.bincount(places[held[nearest[joins & (component == number)]]])
        places[loose[component == number]] = of.argmax()


Seen = tuple[cKDTree, float]


def seen_of(match: Match, gaussians: AnyGaussians) -> Seen:
    """Return what can be seen of a match, and how near is touching."""
    tree = cKDTree(gaussians.shapes_of(solid(gaussians, match.gaussian_ids)).positions)
    last = min(NUM_NEIGHBOURS + 1, tree.n)
    return tree, TOUCH_FACTOR / LINK_FACTOR * _reach(tree.query(tree.data, [last])[0])


def touch(one: Seen, other: Seen) -> bool:
    """Return whether a tenth of the smaller of two matches is within two typical spacings of the larger."""
    (small, reach), (large, far) = sorted((one, other), key=lambda each: int(each[0].n))
    return bool((large.query(small.data)[0] <= max(reach, far)).mean() >= MIN_TOUCHING_SHARE)


def _join_near_parts(points: Points, labels: Indices, reach: float) -> OtherIndices:
    """Return a new label for each part; nearest neighbours alone can leave gaps narrower than the reach."""
    order = np.argsort(labels, kind="stable")
    parts = np.split(points[order], np.flatnonzero(np.diff(labels[order])) + 1)
    low, high = np.array([p.min(0) for p in parts]), np.array([p.max(0) for p in parts])
    trees, edges = [cKDTree(part) for part in parts], []
    for i, part in enumerate(parts):
        gap = np.maximum(low[i + 1 :] - high[i], low[i] - high[i + 1 :])
        for j in i + 1 + np.flatnonzero((gap <= reach).all(1)):
            small, large = (i, j) if len(part) < len(parts[j]) else (j, i)
            if trees[large].query(parts[small], distance_upper_bound=reach)[0].min() <= reach:
                edges.append((i, int(j)))
    ends = np.array(edges, np.int64).reshape(-1, 2)
    return _connected(len(parts), ends[:, 0], ends[:, 1])


def _connected(count: int, source: Indices, target: WholeNumbers) -> OtherIndices:
    edges = coo_array((np.ones(len(source), bool), (source, target)), shape=(count, count))
    return np.asarray(connected_components(edges, directed=False)[1], np.int64)


def _reach(distances: DoubleRows) -> float:
    """Return the linking distance: a multiple of the median distance to the last neighbour."""
    return LINK_FACTOR * float(np.median(distances[:, -1]))
