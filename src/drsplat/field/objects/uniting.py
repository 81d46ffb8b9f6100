"""Nodes of blocks to nodes of the scene: what two blocks see of one region is told by the rows that both look at.

Round by round of the merging, regions of two blocks are one where they share most of these rows; what was one stays
one. So the nodes of the scene are a forest again, whose rows are those within each block.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from ...base.arrays import (
    Arrays,
    Doubles,
    Flags,
    Ids,
    Indices,
    Int64,
    Numbers,
    OtherDoubles,
    OtherIds,
    OtherIndices,
    WholeNumbers,
)
from ...base.working import HERE, Held, Work
from ...kernels import Forest
from ..evidence.aggregation.entries import entry_rows
from ..evidence.evidence import csr_of
from ..forest import with_those_below
from .block_nodes import Block, BlockNodes
from .choosing import NONE

WHOLE_SHARE = 0.8  # of a region's rows: a node that has as many, and is not cut, tells how well masks fit it
PARTNER_IOU = 0.5  # of the rows that both blocks look at: above it each region has one partner at most


class Shared(NamedTuple):
    """Numbers of rows that two blocks look at, by the smallest node of each block that they are in, -1 for none."""

    one: Indices
    other: Indices
    counts: Indices


class United(NamedTuple):
    """forest: nodes of the scene, without single rows. node_of: the smallest node of each row, -1 for none."""

    forest: Forest
    node_of: Ids


class Masses(NamedTuple):
    """rows: the weight of each row of W. masks: of each mask. views: of each mask. far: as of `MergeRule`."""

    rows: OtherDoubles
    masks: Doubles
    views: Ids
    far: float


def united(held: Sequence[Held], blocks: Sequence[Block], masses: Masses, work: Work = HERE) -> United:
    """Return the forest of a scene from those of its blocks. held: the arrays of their `BlockNodes`.

    Where a region is whole in one of the blocks, that one's fit counts; of what is cut in all of them the fit is that
    of all its rows. Memory is that of two blocks, of the nodes, and 4 bytes a row.
    """
    parts = [BlockNodes(**part.arrays) for part in held]
    bases = np.append(0, np.cumsum([len(part.parents) for part in parts]))
    shared = work(Sharing(held, bases), side_by_side(blocks), "comparing blocks")
    moved = [
        np.where(part.parents >= 0, part.parents + base, NONE) for part, base in zip(parts, bases[:-1], strict=True)
    ]
    pairs = [Shared(**one.arrays) for one in shared]
    parents, members, number = _classes(np.concatenate(moved), _together(parts, "ranks"), pairs)
    node_of = np.full(len(masses.rows), NONE, np.int32)
    for part, base in zip(parts, bases[:-1], strict=True):
        own = part.inside & (part.lowest >= 0)
        node_of[part.rows[own]] = number[part.lowest[own] + base]
    held_rows = node_of >= 0
    nodes = node_of[held_rows]
    sizes = with_those_below(parents, np.bincount(nodes, minlength=len(parents)))
    weights = with_those_below(parents, np.bincount(nodes, masses.rows[held_rows], len(parents)))
    fits, spreads = _judged(parts, members, sizes, masses)
    none = np.zeros(len(parents), np.float32)
    forest = Forest(parents, none, sizes.astype(np.int32), weights.astype(np.float32), fits, spreads)
    return United(forest, node_of)


def side_by_side(blocks: Sequence[Block]) -> list[list[int]]:
    """Return the pairs of blocks whose surroundings meet."""
    low = np.array([block.low - block.around for block in blocks])
    high = np.array([block.high + block.around for block in blocks])
    meets = ((low[:, None] <= high) & (high[:, None] >= low)).all(axis=2)
    pairs: list[list[int]] = np.argwhere(np.triu(meets, 1)).tolist()
    return pairs


@dataclass(frozen=True, eq=False)
class Sharing:
    """Finds what two blocks share: a `Part`. bases: the number of each block's first node in the scene."""

    parts: Sequence[Held]
    bases: Int64[np.ndarray, " b1"]

    def __call__(self, pair: list[int], threads: int) -> Arrays:
        one, other = (BlockNodes(**self.parts[number].arrays) for number in pair)
        _, at, there = np.intersect1d(one.rows, other.rows, assume_unique=True, return_indices=True)
        sure = one.sure[at] & other.sure[there]
        nodes = np.stack([one.lowest[at[sure]], other.lowest[there[sure]]], axis=1).astype(np.int64)
        pairs, counts = np.unique(nodes[(nodes >= 0).any(axis=1)], axis=0, return_counts=True)
        a, b = (np.where(side >= 0, side + base, NONE) for side, base in zip(pairs.T, self.bases[pair], strict=True))
        return Shared(a, b, counts)._asdict()


def _classes(
    parents: WholeNumbers, ranks: WholeNumbers, shared: Sequence[Shared]
) -> tuple[OtherIds, tuple[np.ndarray, np.ndarray], Ids]:
    """Return the regions of the scene, each a class of nodes of blocks, round by round.

    These are the parents of all classes, pairs (class, node of it), and the class that each node begins in.
    """
    count = len(parents)
    of, begins = np.full(count, NONE), np.full(count, NONE)  # the class of each node that is on top, now and first
    pairs, total = [np.empty((2, 0), np.int64)], 0
    up: dict[int, int] = {}
    before = np.empty(0, np.int64)
    for rank in np.unique(ranks):
        born = ranks <= rank
        top = np.append(np.where(born, _tops(parents, born), NONE), NONE)
        (now,) = np.nonzero(born & (top[:-1] == np.arange(count)))
        labels = _labels(top, before, of, shared)
        old = np.unique(np.stack([labels[top[before]], of[before]]), axis=1)  # classes of the round before
        held = np.bincount(old[0], minlength=count)
        fresh = np.zeros(count, bool)
        fresh[labels[now[ranks[now] == rank]]] = True
        changed = fresh | (held > 1)
        numbers = np.full(count, NONE)
        numbers[old[0]] = old[1]
        (new,) = np.nonzero(changed & (np.bincount(labels[now], minlength=count) > 0))
        numbers[new] = total + np.arange(len(new))
        total += len(new)
        joined = changed[old[0]]
        up.update(zip(old[1][joined].tolist(), numbers[old[0][joined]].tolist(), strict=True))
        of[now] = numbers[labels[now]]
        pairs.append(np.stack([of[now], now])[:, changed[labels[now]]])
        first = now[ranks[now] == rank]
        begins[first] = of[first]
        before = now
    whole = np.full(total, NONE, np.int32)
    whole[list(up)] = list(up.values())
    together = np.concatenate(pairs, axis=1)
    return whole, (together[0], together[1]), begins.astype(np.int32)


def _labels(top: Int64[np.ndarray, " t1"], before: OtherIndices, of: Indices, shared: Sequence[Shared]) -> Ids:
    """Return a number for each node; nodes on top that are one region now have the same."""
    order = before[np.argsort(of[before], kind="stable")]
    same = of[order][1:] == of[order][:-1]
    edges = [np.stack([top[order[:-1][same]], top[order[1:][same]]])]
    edges += [_matches(top[pair.one], top[pair.other], pair.counts) for pair in shared]
    one, other = np.concatenate(edges, axis=1)
    graph = csr_array((np.ones(len(one), bool), (one, other)), shape=(len(of), len(of)))
    return np.asarray(connected_components(graph, directed=False)[1])


def _tops(parents: WholeNumbers, born: Flags) -> Indices:
    """Return the highest node above each, or itself, among those that are born; parents are born after children."""
    up = np.where((parents >= 0) & born[parents], parents, np.arange(len(parents)))
    while (up != (further := up[up])).any():
        up = further
    return up


def _matches(one: Indices, other: Indices, counts: Indices) -> Int64[np.ndarray, "2 q"]:
    """Return the pairs of regions of two blocks that share more than half of the rows of both."""
    sizes = []
    for side in (one, other):
        _, at = np.unique(side, return_inverse=True)
        sizes.append(np.bincount(at, counts)[at])
    pairs, first, at = np.unique(np.stack([one, other]), axis=1, return_index=True, return_inverse=True)
    both = np.bincount(at.ravel(), counts, minlength=pairs.shape[1])
    alike = both > PARTNER_IOU * (sizes[0][first] + sizes[1][first] - both)
    return np.asarray(pairs[:, alike & (pairs >= 0).all(axis=0)])


def _judged(
    parts: Sequence[BlockNodes], members: tuple[np.ndarray, np.ndarray], sizes: Indices, masses: Masses
) -> tuple[Numbers, Numbers]:
    """Return fits and spreads of all classes. members: pairs (class, node); sizes: rows of each class."""
    of, nodes = members
    cut, fits, spreads = (_together(parts, name) for name in ("cut", "fits", "spreads"))
    counts = (
        with_those_below(p.parents, np.bincount(p.lowest[p.lowest >= 0], minlength=len(p.parents))) for p in parts
    )
    rows = np.concatenate([*counts])[nodes]
    judged, spread = np.zeros(len(sizes), np.float32), np.zeros(len(sizes), np.float32)
    np.maximum.at(spread, of, spreads[nodes])
    order = np.lexsort((-nodes, rows, ~cut[nodes]))  # the last one of a class is the largest that is whole, if any is
    best = np.full(len(sizes), NONE)
    best[of[order]] = order
    judged[of[order]] = fits[nodes[order]]
    partly = cut[nodes[best]] | (rows[best] < WHOLE_SHARE * sizes)
    pieces = partly[of] & cut[nodes]
    number = np.cumsum(partly) - 1
    place = number[of[pieces]], (np.cumsum(cut) - 1)[nodes[pieces]]
    pick = csr_array((np.ones(len(place[0]), np.float32), place), shape=(int(partly.sum()), int(cut.sum())))
    starts = np.concatenate([[0], *(np.diff(part.indptr) for part in parts)])
    sums = csr_of(np.cumsum(starts), _together(parts, "indices"), _together(parts, "data"), len(masses.masks))
    found = fits_of(csr_array(pick @ sums), masses)
    some = np.bincount(place[0], minlength=len(found)) > 0
    judged[np.flatnonzero(partly)[some]] = found[some]
    return judged, spread


def _together(parts: Sequence[BlockNodes], name: str) -> np.ndarray:
    return np.concatenate([getattr(part, name) for part in parts])


def fits_of(weights: csr_array, masses: Masses) -> Doubles:
    """Return how well masks fit regions: the mean over views of the IoU with the best mask there.

    weights: of each region in each mask. Twin: host/regions.cpp, `fit`.
    """
    weights.sort_indices()
    rows = entry_rows(weights)
    order = np.lexsort((masses.views[weights.indices], rows))
    rows, columns, data = rows[order], weights.indices[order], weights.data[order].astype(np.float64)
    if not len(rows):
        return np.zeros(weights.shape[0])
    seen = rows * (int(masses.views.max()) + 1) + masses.views[columns]
    starts = np.flatnonzero(np.append(True, seen[1:] != seen[:-1]))
    shown = np.add.reduceat(data, starts)
    either = np.repeat(shown, np.diff(np.append(starts, len(seen)))) + masses.masks[columns] - data
    best = np.maximum.reduceat(data / either, starts)
    share = shown / (shown + masses.far)
    whole = np.bincount(rows[starts], share, weights.shape[0])
    fits = np.bincount(rows[starts], best * share, weights.shape[0])
    return np.minimum(1, np.divide(fits, whole, out=np.zeros(len(whole)), where=whole > 0))
