"""Search in product-quantised codes (native): every score, those above a threshold, the best, also of many rounds.

Codes lie in groups of 256 rows, sub-vector by sub-vector, so that a scan is one stream through memory. What
is looked up in them are tables, one per query: a score is (sum of look-ups + coarse term) / norm. Tables
are rounded to whole steps, which a machine with AVX-512 VBMI sums in bytes and others in 32 bits: docs/search.md
tells which is used when. Every function is the same to the bit for any number of threads and on every machine
with fused multiply-add, and may be called from several threads at once.
"""

from typing import NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import (
    ByteRows,
    Embeddings,
    Float32,
    FloatRows,
    Ids,
    Indices,
    Numbers,
    OtherIndices,
    SmallIds,
    UInt8,
    UInt16,
    WholeNumbers,
)
from ..errors import InputError
from .algebra import CENTROIDS
from .splats import checked_isa, native, native_array

GROUP_ROWS = 256
MAX_SCORE_ERROR = 1e-4  # never exceeded
HYBRID_SCORE_ERROR = 2e-3  # at six standard deviations
HYBRID_WIDE_SUBVECTORS = 16


class GroupedRows(NamedTuple):
    """Coded features. codes: see `group_codes`. coarse_ids: each row's row of the coarse table, or None."""

    codes: UInt8[np.ndarray, "g L 256"]
    inverse_norms: Numbers
    coarse_ids: SmallIds | None = None


class RowShapes(NamedTuple):
    """Shapes of coded features, wherever they are, and their largest coarse id (0 without)."""

    codes: tuple[int, ...]
    num_rows: int
    coarse_ids: tuple[int, ...] | None
    largest_id: int


class QueryTables(NamedTuple):
    """Inner products of queries with each code's centroid, and with each coarse centroid or None."""

    luts: Float32[np.ndarray, "n L 256"]
    coarse: FloatRows | None = None


class Scanning(NamedTuple):
    """Settings of a scan. error: the largest error of a sum of look-ups.

    wide: 0, or only so many sub-vectors, of the widest range, have tables of more than one byte, and `error`
    is six standard deviations of the rounding: faster. threads: 0 takes all cores. isa: of
    `available_isas()`, "" the best.
    """

    error: float = MAX_SCORE_ERROR
    wide: int = 0
    threads: int = 0
    isa: str = ""


EXACT = Scanning()


def group_codes(codes: ByteRows) -> UInt8[np.ndarray, "g k 256"]:
    """Arrange codes in groups of 256 rows, sub-vector by sub-vector; the last group is padded with zeros."""
    count, subvectors = codes.shape
    grouped = np.empty((-(-count // GROUP_ROWS), subvectors, GROUP_ROWS), np.uint8)
    whole = count // GROUP_ROWS
    grouped[:whole] = codes[: whole * GROUP_ROWS].reshape(whole, GROUP_ROWS, subvectors).transpose(0, 2, 1)
    if whole < len(grouped):
        rest = codes[whole * GROUP_ROWS :]
        grouped[whole], grouped[whole, :, : len(rest)] = 0, rest.T
    return grouped


def rows_of_groups(grouped: UInt8[np.ndarray, "g k 256"], rows: WholeNumbers) -> ByteRows:
    """Return the codes of some rows, one row after the other."""
    return grouped[rows // GROUP_ROWS, :, rows % GROUP_ROWS]


def lookup_tables(
    centroids: Float32[np.ndarray, "L d c"], queries: Embeddings, *, threads: int = 0, isa: str = ""
) -> Float32[np.ndarray, "n L c"]:
    """Return the inner product of each part of each query with each centroid of that part.

    centroids: number by number, (L, D / L, 256).

    Raises: InputError: centroids of another shape.
    """
    subvectors, dim, count = centroids.shape
    if count != CENTROIDS or subvectors * dim != queries.shape[1] or dim == 0:
        raise InputError(
            f"queries of {queries.shape[1]} numbers do not fit centroids {centroids.shape}: "
            f"expected (L, D / L, {CENTROIDS})"
        )
    return native_array("tables", _native.lookup_tables, centroids, queries, threads, checked_isa(isa))


def scan_scores(rows: GroupedRows, tables: QueryTables, how: Scanning = EXACT) -> FloatRows:
    """Return (sum_m lut[m, codes[i, m]] + coarse[coarse_ids[i]]) * inverse_norms[i], for each query and row i.

    Raises: InputError: arrays that do not fit each other.
    Source: Jegou et al. 2011, asymmetric distance; Dr. Splat Eq. 5-6.
    """
    return native_array("scores", _native.scan_scores, *_checked(rows, tables, how))


def scan_above(
    rows: GroupedRows, tables: QueryTables, threshold: float, floor: Numbers | None = None, how: Scanning = EXACT
) -> tuple[OtherIndices, Float32[np.ndarray, " m"]]:
    """Return the rows whose score minus `floor` exceeds the threshold, ascending, and their scores; of one query.

    Raises: InputError: more than one query, or arrays that do not fit each other.
    """
    arguments = _checked(rows, tables, how)
    refuse_several_queries(tables)
    check_floor(floor, len(rows.inverse_norms))
    matches, scores = native("scores", _native.scan_above, *arguments, float(threshold), floor)
    return matches.view(np.int64), scores  # else "long long"


def scan_top(rows: GroupedRows, tables: QueryTables, count: int, how: Scanning = EXACT) -> tuple[Indices, Numbers]:
    """Return the `count` best rows and their scores, best first, ties to the lower row; of one query.

    Raises: InputError: more than one query, a count below 1, or arrays that do not fit each other.
    """
    arguments = _checked(rows, tables, how)
    refuse_several_queries(tables)
    check_count(count)
    best, scores = native("scores", _native.scan_top, *arguments, min(count, len(rows.inverse_norms) + 1))
    return best.view(np.int64), scores  # else "long long"


def scan_best(rows: GroupedRows, tables: QueryTables, how: Scanning = EXACT) -> tuple[Ids, Numbers, Numbers]:
    """Return each row's query of the highest score (ties to the first), that score, and the next highest.

    With one query the next highest is -inf.

    Raises: InputError: arrays that do not fit each other.
    """
    index, scores, runner_up = native("scores", _native.scan_best, *_checked(rows, tables, how))
    return index, scores, runner_up


_ScanArguments = tuple[tuple[object, ...], tuple[object, ...], tuple[object, ...]]


def _checked(rows: GroupedRows, tables: QueryTables, how: Scanning) -> _ScanArguments:
    check_fit(shapes_of(rows), tables)
    if not how.error > 0 or how.wide < 0:
        raise InputError(f"expected an error above 0 and wide of 0 or more, got {how}")
    return tuple(rows), tuple(tables), (how.error, how.wide, how.threads, checked_isa(how.isa))


def shapes_of(rows: GroupedRows) -> RowShapes:
    """Return what `check_fit` needs of rows."""
    ids = rows.coarse_ids
    return RowShapes(
        rows.codes.shape,
        len(rows.inverse_norms),
        None if ids is None else ids.shape,
        0 if ids is None else int(ids.max(initial=0)),
    )


def check_fit(rows: RowShapes, tables: QueryTables) -> None:
    """Refuse rows and tables that do not fit each other, wherever the rows are. Raises: InputError."""
    count, queries = rows.num_rows, len(tables.luts)
    groups, subvectors = -(-count // GROUP_ROWS), rows.codes[1]
    if rows.codes != (groups, subvectors, GROUP_ROWS) or not 0 < subvectors < 1 << 16:
        raise InputError(f"expected codes ({groups}, L, {GROUP_ROWS}) for {count} rows, got {rows.codes}")
    if tables.luts.shape[1:] != (subvectors, CENTROIDS) or not 0 < queries <= 1 << 16:
        raise InputError(
            f"expected tables (Q, {subvectors}, {CENTROIDS}) of 1 to 65536 queries for these codes, "
            f"got {tables.luts.shape}"
        )
    if (rows.coarse_ids is None) != (tables.coarse is None):
        raise InputError("coarse ids belong with coarse tables, and only with them")
    if rows.coarse_ids is not None and tables.coarse is not None:
        if rows.coarse_ids != (count,) or len(tables.coarse) != queries or tables.coarse.shape[1] > 65535:
            raise InputError(
                f"expected {count} coarse ids and tables ({queries}, up to 65535), "
                f"got {rows.coarse_ids} and {tables.coarse.shape}"
            )
        if rows.largest_id >= max(tables.coarse.shape[1], 1):
            raise InputError(f"coarse id {rows.largest_id} of {tables.coarse.shape[1]} coarse centroids")


def check_floor(floor: Numbers | None, count: int) -> None:
    """Refuse a floor of another length than the rows. Raises: InputError."""
    if floor is not None and floor.shape != (count,):
        raise InputError(f"expected a floor per row, got {floor.shape}")


def check_count(count: int) -> None:
    """Refuse to look for less than one row. Raises: InputError."""
    if count < 1:
        raise InputError(f"expected a count of 1 or more, got {count}")


def refuse_several_queries(tables: QueryTables) -> None:
    """Refuse the tables of more than one query. Raises: InputError."""
    if len(tables.luts) != 1:
        raise InputError(f"expected the tables of one query, got {len(tables.luts)}")


def keep_best(
    scores: FloatRows,
    names: UInt16[np.ndarray, "n k"],
    more: Float32[np.ndarray, "c k"],
    first: int,
    *,
    threads: int = 0,
    isa: str = "",
) -> None:
    """Let higher scores take the place of lower ones, in place; of equal ones the earlier stays in front.

    scores: of each row the best, highest first, and their `names`. more: further scores, named first, first + 1, ...

    Raises: InputError: more than 256 scores a row, names above 65,535, arrays that are read-only or do not fit.
    Twin: tests/twins/ranking.py::keep_best.
    """
    try:
        _native.keep_best(scores, names, np.ascontiguousarray(more), first, threads, checked_isa(isa))
    except (TypeError, ValueError) as error:
        raise InputError(f"scores {scores.shape}, names {names.shape}, found {more.shape}: {error}") from None
