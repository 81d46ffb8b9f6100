"""The rows of W, a block at a time: every row's k-th entry at once.

An entry W_ij is one vote: mask j says e_j of Gaussian i, with that weight. A mask belongs to one photo,
so a Gaussian that one mask covers in a photo has one vote of that photo, as in the published methods that
look at one pixel; where masks meet it has several, and the smaller of them can be dropped alone.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, Integer
from scipy.sparse import csr_array

from ..evidence import Evidence, Segments

BLOCK = 1024  # rows: the embeddings of a step, 2 MB at 512 numbers, stay near the processor


@dataclass(frozen=True, eq=False)
class RowBlock:
    """The entries of some rows as tables; rows by falling length, padded at their ends with weight 0.

    positions: of each entry in the arrays of W. active[k]: how many rows, the first ones, have an entry k.
    """

    positions: Int64[np.ndarray, "n k"]
    columns: Integer[np.ndarray, "n k"]
    weights: Float64[np.ndarray, "n k"]
    active: Int64[np.ndarray, " k"]

    @property
    def filled(self) -> Bool[np.ndarray, "n k"]:
        return np.arange(len(self.positions))[:, None] < self.active

    def embeddings(
        self, table: Float32[np.ndarray, "m d"], entry: int
    ) -> Float32[np.ndarray, "a d"]:
        """Of the k-th entry of every row that has one."""
        return table.take(self.columns[: self.active[entry], entry], axis=0)


def row_block(weights: csr_array, begin: int, end: int) -> RowBlock:
    """The entries of rows [begin, end); empty rows have no part in it."""
    starts = weights.indptr[begin : end + 1].astype(np.int64)
    lengths = np.diff(starts)
    order = np.argsort(-lengths, kind="stable")[: np.count_nonzero(lengths)]
    entries = np.arange(lengths.max(initial=0))
    filled = entries < lengths[order, None]
    positions = np.where(filled, starts[order, None] + entries, starts[0])
    if not len(order):
        nothing = np.empty((0, 0))
        return RowBlock(positions, positions, nothing, np.empty(0, np.int64))
    values = np.where(filled, weights.data[positions].astype(np.float64), 0.0)
    return RowBlock(positions, weights.indices[positions], values, filled.sum(axis=0))


def reweighted(
    evidence: Evidence,
    rule: Callable[[RowBlock], Float64[np.ndarray, "n k"]],
    threads: int = 0,
) -> Evidence:
    """The evidence with the weights that `rule` gives to each block of rows; those of 0 are dropped.

    Blocks do not depend on each other, so that any number of threads gives the same bits.
    """
    weights = evidence.weights
    changed = np.zeros(len(weights.data), np.float32)

    def work(begin: int) -> None:
        block = row_block(weights, begin, min(begin + BLOCK, len(evidence)))
        filled = block.filled
        if filled.size:
            changed[block.positions[filled]] = rule(block)[filled]

    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        list(pool.map(work, range(0, len(evidence), BLOCK)))
    return with_weights(evidence, changed)


def with_weights(evidence: Evidence, data: Float32[np.ndarray, " e"]) -> Evidence:
    """Other weights of the same entries; entries of weight 0 are dropped."""
    old = evidence.weights
    kept = data > 0
    if kept.all():
        matrix = csr_array((data, old.indices, old.indptr), shape=old.shape)
    else:
        before = np.concatenate([[0], np.cumsum(kept)])
        indptr = before[old.indptr].astype(old.indptr.dtype)
        matrix = csr_array((data[kept], old.indices[kept], indptr), shape=old.shape)
    return replace(evidence, weights=matrix)


def canonical(evidence: Evidence) -> Evidence:
    """Columns by view name, then segment id, and entries of a row in that order.

    So registrations leave them; evidence made by hand may not be so. Itself where it is.
    """
    segments, weights = evidence.segments, evidence.weights
    names = sorted(segments.view_names)
    rank = {name: i for i, name in enumerate(names)}
    views = np.array([rank[name] for name in segments.view_names], np.int32)[segments.views]
    order = np.lexsort((segments.ids, views))
    if (np.diff(order) == 1).all() and weights.has_sorted_indices:
        return evidence
    columns = csr_array(weights[:, order])
    columns.sort_indices()
    ordered = Segments(tuple(names), views[order], segments.ids[order])
    return Evidence(columns, ordered, evidence.embeddings[order])
