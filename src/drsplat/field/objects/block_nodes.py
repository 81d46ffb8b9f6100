"""Nodes of a block's forest: regions of Gaussians in it and around it, as masks of all photos hold them together."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack

from ...base.arrays import Bool, Float32, Int32, Int64
from ...kernels import Forest, MergeRule, agglomerate
from .blocks import BlockRows
from .choosing import NONE, _owners, pairs_above
from .neighbours import neighbours

EDGE_SHARE = 0.9  # of the way to the end of the surroundings: what has rows beyond it goes on outside
INNER_SHARE = 2 / 3  # of that way: rows within tell which nodes of two blocks are one
MIN_SHOWN_SHARE = 0.01  # of a block's weight in the best view
ROUNDING_SHARE = 1e-4  # of a mask's weight


class BlockNodes(NamedTuple):
    """Regions of a block that are large enough to be judged; a parent has a higher number, -1 is none.

    rows: of the field, in the block and around it, ascending. lowest: the smallest node that a row is in, -1 for none.
    inside: rows of the block itself. sure: rows that are far from the end of its surroundings. ranks: round of the
    merge, of all blocks alike. cut: nodes that go on beyond the surroundings; indptr, indices, data: the weights of
    their rows inside in each mask, a row for each node that is cut. views: those that see the block.
    """

    rows: Int64[np.ndarray, " n"]
    lowest: Int32[np.ndarray, " n"]
    inside: Bool[np.ndarray, " n"]
    sure: Bool[np.ndarray, " n"]
    parents: Int32[np.ndarray, " t"]
    ranks: Int32[np.ndarray, " t"]
    fits: Float32[np.ndarray, " t"]
    spreads: Float32[np.ndarray, " t"]
    cut: Bool[np.ndarray, " t"]
    indptr: Int64[np.ndarray, " c1"]
    indices: Int32[np.ndarray, " e"]
    data: Float32[np.ndarray, " e"]
    views: Int32[np.ndarray, " v"]


def nodes_of(block: BlockRows, thresholds: tuple[float, ...], rule: MergeRule, threads: int = 0) -> BlockNodes:
    """Grow the forest of a block and what is around it. The same bits at any number of threads."""
    weights, count = block.weights, len(block.rows)
    rest = np.maximum(block.masses - np.bincount(block.indices, block.data, len(block.columns)), 0)
    elsewhere = csr_array(np.where(rest > ROUNDING_SHARE * block.masses, rest, 0).astype(np.float32)[None])
    everything = csr_array(vstack([weights, elsewhere]))  # a row without neighbours: what masks hold beyond the block
    edges = neighbours(block.points, threads)
    forest = agglomerate(everything, block.views, block.embeddings, edges, thresholds, rule, threads=threads)
    judged = forest.sizes >= rule.smallest
    number = np.append(np.cumsum(judged) - 1, NONE)
    owners = _owners(forest.parents, judged)
    lowest = number[owners][:count]
    (nodes,) = np.nonzero(judged)
    parents, inside = number[forest.parents[nodes]], block.away == 0
    cut = _holding_any(parents, lowest[block.away > EDGE_SHARE])
    sums = _sums(weights, np.where(inside, lowest, NONE), parents, cut)
    order = np.argsort(block.rows)
    return BlockNodes(
        block.rows[order], lowest[order].astype(np.int32), inside[order], (block.away <= INNER_SHARE)[order],
        parents.astype(np.int32), _ranks(forest, thresholds)[nodes], forest.fits[nodes], forest.spreads[nodes], cut,
        sums.indptr.astype(np.int64), block.columns[sums.indices], sums.data.astype(np.float32), _seeing(block, inside),
    )  # fmt: skip


def _seeing(block: BlockRows, inside: Bool[np.ndarray, " n"]) -> Int32[np.ndarray, " v"]:
    """Return the views with more than a sliver of the weight that the best view has inside the block."""
    held = np.repeat(inside, np.diff(block.indptr))
    shown = np.bincount(block.views[block.indices[held]], block.data[held])
    return np.flatnonzero(shown > MIN_SHOWN_SHARE * shown.max(initial=0)).astype(np.int32)


def _holding_any(parents: Int64[np.ndarray, " t"], nodes: Int64[np.ndarray, " k"]) -> Bool[np.ndarray, " t"]:
    """Mark nodes that are among some or above one of them."""
    holding, at = np.zeros(len(parents), bool), np.unique(nodes[nodes >= 0])
    while len(at):
        holding[at] = True
        at = np.unique(parents[at])
        at = at[at >= 0]
    return holding


def _ranks(forest: Forest, thresholds: tuple[float, ...]) -> Int32[np.ndarray, " t"]:
    """Return the round of each merge: two for each threshold, the second where one of the first is merged further."""
    steps = np.searchsorted(-np.array(thresholds, np.float32), -forest.agreements)
    (below,) = np.nonzero((forest.parents >= 0) & (forest.sizes > 1))
    above = forest.parents[below]
    again = np.zeros(len(steps), bool)
    again[above[steps[below] == steps[above]]] = True
    return (2 * steps + again).astype(np.int32)


def _sums(
    weights: csr_array, nodes: Int64[np.ndarray, " n"], parents: Int64[np.ndarray, " t"], cut: Bool[np.ndarray, " t"]
) -> csr_array:
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
