"""The rows of W, a block at a time: every row's k-th entry at once.

An entry W_ij is one vote: mask j says e_j of Gaussian i, with that weight. A mask belongs to one photo,
so a Gaussian that one mask covers in a photo has one vote of that photo, as in the published methods that
look at one pixel; where masks meet it has several, and the smaller of them can be dropped alone.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from ....base.arrays import (
    Bool,
    DoubleRows,
    Embeddings,
    Flags,
    IndexRows,
    Indices,
    Int64,
    Integer,
    Numbers,
    OtherEmbeddings,
    OtherFlags,
    OtherIndices,
    RowIds,
    WholeNumbers,
)
from ....base.contents import release
from ..evidence import Evidence, MaskIds, csr_of

BLOCK_ROWS = 1024  # the embeddings of a step, 2 MB at 512 numbers, stay in the processor's cache
BLOCK_CELLS = 1 << 19  # at most, in a block's tables: rows of many votes come in smaller blocks
PASS_ENTRIES = 1 << 20  # of W at once, in passes over all of them: bounds the memory beside it


@dataclass(frozen=True, eq=False)
class RowBlock:
    """The entries of some rows as tables; rows by falling length, padded at their ends with weight 0.

    positions: of each entry in the arrays of W. active[k]: how many rows, the first ones, have an entry k.
    """

    positions: IndexRows
    columns: Integer[np.ndarray, "n k"]
    weights: DoubleRows
    active: Int64[np.ndarray, " k"]

    @property
    def filled(self) -> Bool[np.ndarray, "n k"]:
        return np.arange(len(self.positions))[:, None] < self.active

    def embeddings(self, table: OtherEmbeddings, entry: int) -> Embeddings:
        """Return the embedding of the k-th entry (k = `entry`) of every row that has one."""
        return table.take(self.columns[: self.active[entry], entry], axis=0)


Rule = Callable[[RowBlock], DoubleRows]
"""A number per entry of a block."""


def reweighted(evidence: Evidence, rule: Rule, threads: int = 0) -> Evidence:
    """Return the evidence with the weights that `rule` gives to each block of rows; those of 0 are dropped."""
    return with_weights(evidence, entry_values(evidence, rule, threads))


def entry_values(evidence: Evidence, rule: Rule, threads: int = 0) -> Numbers:
    """Return the value of `rule` for each entry of W, in the order of its arrays.

    Blocks do not depend on each other, so that any number of threads gives the same bits.
    """
    weights = evidence.weights
    values = np.zeros(len(weights.data), np.float32)
    lengths = np.diff(weights.indptr)
    # Rows of like length go together, so that their tables are full.
    order = np.argsort(-lengths, kind="stable")[: np.count_nonzero(lengths)]

    def work(rows: Indices) -> None:
        starts = weights.indptr[rows].astype(np.int64)
        entries = np.arange(lengths[rows[0]])
        filled = entries < lengths[rows, None]
        positions = np.where(filled, starts[:, None] + entries, starts[0])
        held = np.where(filled, weights.data[positions].astype(np.float64), 0.0)
        block = RowBlock(positions, weights.indices[positions], held, filled.sum(0))
        values[block.positions[block.filled]] = rule(block)[block.filled]

    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        list(pool.map(work, _blocks(order, lengths)))
    return values


def _blocks(order: OtherIndices, lengths: WholeNumbers) -> Iterator[Indices]:
    """Yield rows by falling length in blocks of at most BLOCK_ROWS, and BLOCK_CELLS entries unless one row has more."""
    begin = 0
    while begin < len(order):
        size = min(BLOCK_ROWS, max(1, BLOCK_CELLS // int(lengths[order[begin]])))
        yield order[begin : begin + size]
        begin += size


def with_weights(evidence: Evidence, data: Numbers) -> Evidence:
    """Return the evidence with other weights of the same entries; entries of weight 0 are dropped."""
    old = evidence.weights
    matrix = csr_array((data, old.indices, old.indptr), shape=old.shape)
    kept = data > 0
    return replace(evidence, weights=matrix if kept.all() else with_entries(matrix, kept))


def with_entries(matrix: csr_array, held: OtherFlags) -> csr_array:
    """Return a matrix of some of the entries alone."""
    starts = np.append(0, np.cumsum(held))[matrix.indptr]
    return csr_of(starts, matrix.indices[held], matrix.data[held], matrix.shape[1])


def row_chunks(weights: csr_array) -> Iterator[slice]:
    """Yield slices of rows with about PASS_ENTRIES entries each; a memory-mapped W is never in memory as a whole."""
    ends = np.arange(PASS_ENTRIES, weights.indptr[-1] + PASS_ENTRIES, PASS_ENTRIES)
    stops = np.unique([0, *np.searchsorted(weights.indptr, ends), len(weights.indptr) - 1])
    for begin, end in pairwise(stops[stops < len(weights.indptr)].tolist()):
        yield slice(begin, end)
        release(weights.indices, weights.data)


def of_columns(evidence: Evidence, kept: Flags) -> Evidence:
    """Return the evidence without the entries of the columns that are not kept, and without those of weight 0."""
    old, lengths = evidence.weights, np.zeros(len(evidence) + 1, np.int64)
    indices, data = [np.empty(0, old.indices.dtype)], [np.empty(0, np.float32)]
    for rows in row_chunks(old):
        starts = old.indptr[rows.start : rows.stop + 1].astype(np.int64)
        columns, values = old.indices[starts[0] : starts[-1]], old.data[starts[0] : starts[-1]]
        held = kept[columns] & (values > 0)
        indices.append(columns[held])
        data.append(values[held])
        lengths[rows.start + 1 : rows.stop + 1] = np.diff(np.append(0, np.cumsum(held))[starts - starts[0]])
    weights = csr_of(np.cumsum(lengths), np.concatenate(indices), np.concatenate(data), old.shape[1])
    return replace(evidence, weights=weights)


def entry_rows(matrix: csr_array) -> Indices:
    """Return the row of each entry."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def view_runs(views: RowIds, starts: WholeNumbers) -> np.ndarray:
    """Return where entries of another photo, or of another row, begin; those of a photo are adjacent.

    views: of the entries of some rows. starts: of each row, and the number of all entries.
    """
    new = np.zeros(len(views) + 1, np.bool_)
    new[1:-1] = views[1:] != views[:-1]
    new[starts] = True
    return np.flatnonzero(new[:-1])


def column_counts(weights: csr_array) -> Indices:
    """Count the entries of each column."""
    counts = np.zeros(weights.shape[1], np.int64)
    for rows in row_chunks(weights):
        columns = weights.indices[weights.indptr[rows.start] : weights.indptr[rows.stop]]
        counts += np.bincount(columns, minlength=len(counts))
    return counts


def canonical(evidence: Evidence) -> Evidence:
    """Sort the columns by view name, then mask id, and the entries of each row in that order.

    Registrations are sorted, evidence made by hand may not be; sorted evidence is returned as it is.
    """
    weights = evidence.weights
    masks, order = by_name(evidence.masks)
    if (np.diff(order) == 1).all() and weights.has_sorted_indices:
        return evidence
    columns = csr_array(weights[:, order])
    columns.sort_indices()
    return Evidence(columns, masks, evidence.embeddings[order])


def by_name(masks: MaskIds) -> tuple[MaskIds, Indices]:
    """Return the masks by view name, then mask id, and which columns they are."""
    views = np.argsort(np.array(masks.view_names, object), kind="stable")
    order = np.lexsort((masks.ids, np.argsort(views)[masks.views]))
    return masks.taken(views, order), order
