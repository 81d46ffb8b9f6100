"""The objects of the highest cosines with a query: by codes, of which the best are compared exactly, or all of them."""

import math
from typing import NamedTuple

import numpy as np

from ...base.arrays import Embedding, Indices, Numbers, OtherIndices
from ..ranking import Described
from .entries import Conditions
from .snapshot import Snapshot, lengths_of

ANYWHERE = Conditions()
REFINE_FACTOR = 4  # candidates compared exactly, per wanted object; of large catalogues more
LARGE_ROWS = 750_000  # from here on the factor grows with the root of the rows
FEW_ROWS = 20_000  # that meet a condition: comparing them all is quicker than the codes of all
ROWS_OF_THREADS = 1 << 16  # descriptors of a part from which a second thread is worth its start
DESCRIPTORS_PER_WANTED = 3  # that are looked at for an object that is wanted, at first
GROWTH = 4  # times as many, if those were too few
ROWS_AT_ONCE = 8192  # of which descriptors are in memory while all are compared
AT_ONCE = 128  # descriptors that are compared while they are in a processor's cache


class Search(NamedTuple):
    """Search for objects. vector: of unit length; wanted: number of objects."""

    vector: Embedding
    where: Conditions
    wanted: int
    threads: int


class Nearest(NamedTuple):
    """Rows of the highest cosines, ascending, and their descriptors. is_exact: all were compared."""

    rows: Indices
    described: Described
    is_exact: bool


def nearest_objects(snapshot: Snapshot, search: Search, exact: bool) -> Nearest:
    """Return the objects of the highest cosines, by codes where there are some and many objects are looked at.

    exact: compare all of them.

    Raises: FormatError: damaged rows or codes.
    """
    rows = snapshot.all_rows if search.where == ANYWHERE else snapshot.rows(search.where)
    few = 0 if search.where == ANYWHERE else FEW_ROWS
    is_exact = exact or snapshot.codes is None or len(rows) <= few
    best = _best(snapshot, rows if is_exact else _candidates(snapshot, search, rows), search)
    return Nearest(best, snapshot.described(best), is_exact)


def refine_factor(rows: int) -> int:
    """Return how many candidates are compared for each wanted object: of more rows codes put more before the best."""
    return max(REFINE_FACTOR, round(REFINE_FACTOR * math.sqrt(rows / LARGE_ROWS)))


def _best(snapshot: Snapshot, rows: Indices, search: Search) -> OtherIndices:
    """Return those of ascending rows with the highest cosines, ascending; rows without descriptors are left out."""
    best, cosines = np.empty(0, np.int64), np.empty(0, np.float32)
    for begin in range(0, len(rows), ROWS_AT_ONCE):
        block = rows[begin : begin + ROWS_AT_ONCE]
        best = np.append(best, block)
        cosines = np.append(cosines, _cosines(snapshot, block, search.vector))
        order = np.lexsort((best, -cosines))[: search.wanted]
        order = order[np.isfinite(cosines[order])]
        best, cosines = best[order], cosines[order]
    return np.sort(best)


def _cosines(snapshot: Snapshot, rows: Indices, vector: Embedding) -> Numbers:
    """Return the highest cosine of a unit vector with a descriptor of each row, -inf for rows without any."""
    numbers, starts = snapshot.stored(rows)
    cosines = np.empty(len(numbers), np.float32)
    for begin in range(0, len(numbers), AT_ONCE):
        run = slice(begin, begin + AT_ONCE)
        vectors = numbers[run].astype(np.float32)
        cosines[run] = np.einsum("pd,d->p", vectors, vector) / lengths_of(vectors, snapshot.path)
    best = np.full(len(rows), -np.inf, np.float32)
    (shown,) = np.nonzero(np.diff(starts))
    if len(shown):
        best[shown] = np.maximum.reduceat(cosines, starts[shown])
    return best


def _candidates(snapshot: Snapshot, search: Search, allowed: Indices) -> OtherIndices:
    """Return the allowed rows of the best codes, several for each that is wanted, ascending."""
    total, num_descriptors = int(snapshot.firsts[-1]), sum(len(code) for code in snapshot.codes or ())
    least = refine_factor(total) * search.wanted
    count = DESCRIPTORS_PER_WANTED * least * -(-total // max(len(allowed), 1))
    while True:
        rows = _top(snapshot, search, min(count, num_descriptors))
        at = np.minimum(np.searchsorted(allowed, rows), len(allowed) - 1)
        rows = rows[allowed[at] == rows]
        distinct = rows[np.sort(np.unique(rows, return_index=True)[1])]
        if len(distinct) >= least or count >= num_descriptors:
            return np.sort(distinct[:least])
        count *= GROWTH


def _top(snapshot: Snapshot, search: Search, count: int) -> Indices:
    """Return the rows of the `count` best descriptors, best first."""
    rows, scores = [np.empty(0, np.int64)], [np.empty(0, np.float32)]
    for first, part, code in zip(snapshot.firsts.tolist(), snapshot.parts, snapshot.codes or (), strict=False):
        hits = code.top(search.vector, count, threads=search.threads if len(code) >= ROWS_OF_THREADS else 1)
        rows.append(first + np.searchsorted(part.starts["p"], hits.rows, "right") - 1)
        scores.append(hits.scores)
    return np.concatenate(rows)[np.argsort(-np.concatenate(scores), kind="stable")[:count]]
