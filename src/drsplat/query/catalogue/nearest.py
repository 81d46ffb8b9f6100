"""The objects of the highest cosines with a query: by codes, of which the best are compared exactly, or all."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Float32, Int64
from ..ranking import Described
from .codes import Coded
from .lance import libraries
from .schema import cosines_of, described_of
from .snapshot import ROW_ID, Snapshot

REFINE_FACTOR = 4  # candidates compared exactly, per wanted object; of large tables more
LARGE_ROWS = 750_000  # from here on the factor grows with the root of the rows
FEW_ROWS = 20_000  # that meet a condition: comparing them all is quicker than the codes of all


class Search(NamedTuple):
    """Search for objects. vector: of unit length; where: SQL, "" for all; wanted: number of objects."""

    vector: Float32[np.ndarray, " D"]
    where: str
    wanted: int
    threads: int


class Nearest(NamedTuple):
    """Objects of the highest cosines, as an Arrow table, and their descriptors. is_exact: all were compared."""

    rows: Any
    described: Described
    is_exact: bool


def nearest_objects(snapshot: Snapshot, codes: Coded | None, search: Search) -> Nearest:
    """Return the objects of the highest cosines, by codes where there are some and many objects are looked at."""
    allowed = snapshot.row_ids(search.where) if codes and search.where else None
    if codes is None or (allowed is not None and len(allowed) <= FEW_ROWS):
        rows = snapshot.nearest(search.vector, search.where, search.wanted)
        return Nearest(rows, described_of(rows["descriptors"], snapshot.path), is_exact=True)
    parts = [_by_codes(snapshot, codes, search, allowed)]
    if codes.without:
        own = " OR ".join(fragment.sql for fragment in codes.without)
        parts.append(snapshot.nearest(search.vector, f"({own}) AND {search.where or 'true'}", search.wanted))
    rows, described = _best(snapshot, parts, search)
    return Nearest(rows, described, is_exact=False)


def _by_codes(snapshot: Snapshot, codes: Coded, search: Search, allowed: Int64[np.ndarray, " a"] | None) -> Any:
    """Return the rows of the best codes, several for each that is wanted; codes of deleted ones are passed over."""
    least = count = refine_factor(snapshot.num_rows) * search.wanted
    while True:
        found = codes.nearest(search.vector, count, allowed, search.threads)
        rows = snapshot.take(found.row_ids)
        if found.is_all or rows.num_rows >= least:
            return rows
        count *= 2


def refine_factor(rows: int) -> int:
    """Return how many candidates are compared for each wanted object: of more rows codes put more before the best."""
    return max(REFINE_FACTOR, round(REFINE_FACTOR * math.sqrt(rows / LARGE_ROWS)))


def _best(snapshot: Snapshot, parts: list[Any], search: Search) -> tuple[Any, Described]:
    _, pa = libraries()
    rows = pa.concat_tables(parts)
    row_ids = np.asarray(rows[ROW_ID]).astype(np.int64)
    cosines = cosines_of(rows["descriptors"], search.vector, snapshot.path)
    rows = rows.take(np.lexsort((row_ids, -cosines))[: search.wanted])
    return rows, described_of(rows["descriptors"], snapshot.path)
