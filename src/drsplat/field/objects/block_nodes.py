"""Nodes of a block's forest: regions of Gaussians in it and around it, as masks of all photos hold them together.

Where a block ends is told by places and weights alone, not by tiles, workers or the order of rows.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree

from ...base.arrays import (
    AnyPoints,
    Arrays,
    DoubleRows,
    Doubles,
    Flags,
    Float32,
    Ids,
    Indices,
    Int32,
    Int64,
    Numbers,
    OtherFlags,
    OtherIds,
    OtherIndices,
    Vector3,
    Vectors,
    WholeNumbers,
)
from ...base.working import Held
from ...kernels import Forest, MergeRule, agglomerate
from ...scene.morton import morton_codes, morton_order
from ..evidence.aggregation.entries import with_entries
from ..evidence.evidence import csr_of
from ..evidence.pieces import HeldRows
from ..forest import owner_nodes
from .choosing import NONE, holding, pairs_above

EDGE_SHARE = 0.9  # of the way to the end of the surroundings: what has rows beyond it goes on outside
INNER_SHARE = 2 / 3  # of that way: rows within tell which nodes of two blocks are one
MIN_SHOWN_SHARE = 0.01  # of a block's weight in the best view
ROUNDING_SHARE = 1e-4  # of a mask's weight
SURROUNDINGS_SHARE = 0.3  # of a block's longest side
BULK_QUANTILES = (0.01, 0.99)  # of places: a side is measured between them, without strays
CURVE_BITS = 10  # of each coordinate
ROWS_AT_ONCE = 1 << 20

NUM_NEIGHBOURS = 12
MAX_USUAL_DISTANCES = 4.0  # to the sixth neighbour, of the scene or of the Gaussian

POINTS_AT_ONCE = 1 << 16


class Block(NamedTuple):
    """A box that ends nowhere at the sides of the scene. around: how far its surroundings reach beyond it."""

    low: Vector3
    high: Vector3
    around: float

    def away(self, points: Vectors) -> Doubles:
        """Return how far points are from the block, along the axis of the largest distance; 0 within, its end is out.

        In parts of `around`: surroundings reach up to 1.
        """
        outside = np.maximum(np.maximum(self.low - points, points - self.high), 0).max(axis=1)
        ends = (points >= self.high).any(axis=1) & (outside == 0)
        return np.asarray(np.where(ends, np.finfo(np.float64).tiny, outside / self.around))


def in_blocks(points: Vectors, counts: WholeNumbers, most: int) -> list[Block]:
    """Cut a scene in halves, at medians along its longest side, until no block has more than `most` weights.

    counts: weights of each point. A block whose points are all in one place stays as it is.
    """
    blocks = []
    waiting = [(np.arange(len(points)), np.full(3, -np.inf), np.full(3, np.inf))]
    while waiting:
        rows, low, high = waiting.pop()
        sides = np.subtract(*np.quantile(points[rows], BULK_QUANTILES[::-1], axis=0)) if len(rows) else np.zeros(3)
        axis = int(sides.argmax())
        middle = np.median(points[rows, axis]) if len(rows) else 0.0
        below = points[rows, axis] < middle
        if int(counts[rows].sum(dtype=np.int64)) <= most or not below.any():
            blocks.append(Block(low, high, max(SURROUNDINGS_SHARE * float(sides[axis]), 1e-9)))
            continue
        upper, lower = low.copy(), high.copy()
        upper[axis] = lower[axis] = middle
        waiting += [(rows[~below], upper, high), (rows[below], low, lower)]
    return blocks


@dataclass(frozen=True, eq=False)
class Nodes:
    """Finds the nodes of blocks: a `Part`.

    scene: `points` and `sums`, places and weights of the rows of W; of its columns `kept`, those that are looked at,
    `masses`, weights in the whole scene, `views`, never falling, and `embeddings`.
    """

    weights: HeldRows
    scene: Held
    thresholds: tuple[float, ...]
    rule: MergeRule

    def __call__(self, block: Block, threads: int) -> Arrays:
        """Grow the forest of a block and what is around it. The same bits at any number of threads."""
        scene = self.scene.arrays
        rows = self._around(block)
        points, weights = scene["points"][rows], self.weights.rows(rows)
        weights = with_entries(weights, scene["kept"][weights.indices] & (weights.data > 0))
        columns, indices = np.unique(weights.indices, return_inverse=True)
        weights = csr_of(weights.indptr, indices.astype(np.int32), weights.data, len(columns))
        views, masses, embeddings = (scene[name][columns] for name in ("views", "masses", "embeddings"))
        rest = np.maximum(masses - np.bincount(weights.indices, weights.data, len(columns)), 0)
        elsewhere = csr_array(np.where(rest > ROUNDING_SHARE * masses, rest, 0).astype(np.float32)[None])
        everything = csr_array(vstack([weights, elsewhere]))  # a row without neighbours: what masks hold elsewhere
        edges = neighbours(points, threads)
        forest = agglomerate(everything, views, embeddings, edges, self.thresholds, self.rule, threads=threads)
        (nodes,) = np.nonzero(forest.sizes >= self.rule.smallest)
        judged = np.zeros(len(forest.sizes), bool)
        judged[nodes] = True
        number = np.append(np.cumsum(judged) - 1, NONE)
        lowest = number[owner_nodes(forest.parents, judged)][: len(rows)]
        parents, away = number[forest.parents[nodes]], block.away(points)
        inside, cut = away == 0, holding(parents, lowest[away > EDGE_SHARE])
        sums = _sums(weights, np.where(inside, lowest, NONE), parents, cut)
        held = np.repeat(inside, np.diff(weights.indptr))
        shown = np.bincount(views[weights.indices[held]], weights.data[held])
        order = np.argsort(rows)
        return BlockNodes(
            rows[order], lowest[order].astype(np.int32), inside[order], (away <= INNER_SHARE)[order],
            parents.astype(np.int32), _ranks(forest, self.thresholds)[nodes], forest.fits[nodes],
            forest.spreads[nodes], cut, sums.indptr.astype(np.int64), columns[sums.indices].astype(np.int32),
            sums.data.astype(np.float32),
            np.flatnonzero(shown > MIN_SHOWN_SHARE * shown.max(initial=0)).astype(np.int32),
        )._asdict()  # fmt: skip

    def _around(self, block: Block) -> Indices:
        """Return the rows of W in a block and around it, in an order that does not depend on that of the scene's."""
        points, parts = self.scene.arrays["points"], [np.empty(0, np.int64)]
        for begin in range(0, len(points), ROWS_AT_ONCE):
            parts.append(begin + np.flatnonzero(block.away(points[begin : begin + ROWS_AT_ONCE]) <= 1))
        rows = np.concatenate(parts)
        return rows[_placed_order(points[rows], self.scene.arrays["sums"][rows])]


def _placed_order(points: Vectors, sums: Doubles) -> Indices:
    """Return an order along a curve that only places decide, and sums of weights where places are equal."""
    if not len(points):
        return np.empty(0, np.int64)
    codes = morton_codes(_without_strays(points), CURVE_BITS)
    return np.lexsort((sums, points[:, 2], points[:, 1], points[:, 0], codes))


class BlockNodes(NamedTuple):
    """Regions of a block that are large enough to be judged; a parent has a higher number, -1 is none.

    rows: of the field, in the block and around it, ascending. lowest: the smallest node that a row is in, -1 for none.
    inside: rows of the block itself. sure: rows that are far from the end of its surroundings. ranks: round of the
    merge, of all blocks alike. cut: nodes that go on beyond the surroundings; indptr, indices, data: the weights of
    their rows inside in each mask, a row for each node that is cut. views: those that see the block.
    """

    rows: OtherIndices
    lowest: Int32[np.ndarray, " m"]
    inside: OtherFlags
    sure: OtherFlags
    parents: Ids
    ranks: Ids
    fits: Numbers
    spreads: Numbers
    cut: Flags
    indptr: Int64[np.ndarray, " c1"]
    indices: Int32[np.ndarray, " e"]
    data: Float32[np.ndarray, " e"]
    views: OtherIds


def _ranks(forest: Forest, thresholds: tuple[float, ...]) -> Ids:
    """Return the round of each merge: two for each threshold, the second where one of the first is merged further."""
    steps = np.searchsorted(-np.array(thresholds, np.float32), -forest.agreements)
    (below,) = np.nonzero((forest.parents >= 0) & (forest.sizes > 1))
    above = forest.parents[below]
    again = np.zeros(len(steps), bool)
    again[above[steps[below] == steps[above]]] = True
    return (2 * steps + again).astype(np.int32)


def _sums(weights: csr_array, nodes: OtherIndices, parents: Indices, cut: Flags) -> csr_array:
    """Return (C, M) the weights of the rows in each node that is cut. nodes: the lowest of each row, -1 for none."""
    (rows,), count = np.nonzero(nodes >= 0), len(parents)
    own = csr_array((np.ones(len(rows), np.float32), (nodes[rows], rows)), shape=(count, len(nodes)))
    below, above = pairs_above(parents)
    number = np.append(np.cumsum(cut) - 1, NONE)
    kept = cut[above]
    place = number[above[kept]], below[kept]
    inside = csr_array((np.ones(len(place[0]), np.float32), place), shape=(int(cut.sum()), count))
    summed = csr_array(inside @ (own @ weights))
    summed.sort_indices()
    return summed


def along_a_curve(points: AnyPoints) -> Indices:
    """Return the rows of points in Morton order: what is near in space then mostly lies near in memory too."""
    if not len(points):
        return np.zeros(0, np.int64)
    return morton_order(_without_strays(points), CURVE_BITS)


def _without_strays(points: AnyPoints) -> AnyPoints:
    return np.clip(points, *np.quantile(points, BULK_QUANTILES, axis=0))


def neighbours(points: AnyPoints, threads: int = 0) -> Int32[np.ndarray, "e 2"]:
    """Return the pairs (a, b), a < b, of which one is among the nearest twelve of the other, and not far; ascending."""
    count = min(NUM_NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros((0, 2), np.int32)
    distances, found = _nearest(points, count, threads)
    sixth = distances[:, (count + 1) // 2 - 1]
    reach = MAX_USUAL_DISTANCES * np.maximum(sixth, np.median(sixth))
    keys = np.concatenate([_keys(found, distances, reach, begin) for begin in range(0, len(points), POINTS_AT_ONCE)])
    del distances, found
    keys.sort()  # quicker than np.unique, which hashes
    keys = keys[np.append(True, keys[1:] != keys[:-1])] if len(keys) else keys
    edges = np.empty((len(keys), 2), np.int32)
    np.floor_divide(keys, len(points), out=edges[:, 0], casting="unsafe")
    np.remainder(keys, len(points), out=edges[:, 1], casting="unsafe")
    return edges


def _nearest(points: AnyPoints, count: int, threads: int) -> tuple[DoubleRows, Int32[np.ndarray, "n k"]]:
    """Return distances and rows of each point's nearest but the first, which mostly is itself, in blocks."""
    tree = cKDTree(points)
    distances, found = np.empty((len(points), count)), np.empty((len(points), count), np.int32)
    for begin in range(0, len(points), POINTS_AT_ONCE):
        rows = slice(begin, begin + POINTS_AT_ONCE)
        far, which = tree.query(points[rows], count + 1, workers=threads or -1)
        distances[rows], found[rows] = far[:, 1:], which[:, 1:]
    return distances, found


def _keys(found: Int32[np.ndarray, "n k"], distances: DoubleRows, reach: Doubles, begin: int) -> OtherIndices:
    """Return a number for each pair of neighbours of some rows, the same whichever of the two it comes from."""
    rows = slice(begin, begin + POINTS_AT_ONCE)
    near = distances[rows] <= reach[rows, None]
    first = np.broadcast_to(np.arange(begin, begin + len(near))[:, None], near.shape)[near]
    second = found[rows][near].astype(np.int64)
    other = first != second  # of points in one place, none may find itself first
    low, high = np.minimum(first, second)[other], np.maximum(first, second)[other]
    return np.asarray(low * len(found) + high)
