"""Features as product-quantised codes, in the order in which they are scanned."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.arrays import Arrays, Embedding, Embeddings, FloatRows, Numbers, SmallIds, UInt8, WholeNumbers
from ...errors import InputError
from ...kernels import (
    GroupedRows,
    QueryTables,
    Scanning,
    group_codes,
    rows_of_groups,
    scan_above,
    scan_best,
    scan_scores,
    scan_top,
)
from ...kernels.scan import GROUP_ROWS, HYBRID_SCORE_ERROR, HYBRID_WIDE_SUBVECTORS, MAX_SCORE_ERROR
from .code import Best, Hits, check_run
from .codebook import Codebook, Codes

MAX_EXACT_QUERIES = 16  # among so few the best is chosen exactly
BATCH_QUERIES = 256  # whose tables are held at once
MAX_TABLE_SCALE = 64.0  # rows shorter than 1 / 64 get no finer tables


@dataclass(frozen=True, eq=False)
class PQCode:
    """Product-quantised code, a byte per sub-vector and row, scanned with a table per query.

    grouped: as `kernels.group_codes` lays codes out; padding past the last row is never read.
    coarse_ids: a coarse centroid per row, or None for a plain codebook. inverse_norms: 1 / norm of each
    decoded feature, 0 where it is zero.

    Raises: InputError: arrays that do not fit each other or the codebook.
    """

    codebook: Codebook
    grouped: UInt8[np.ndarray, "g L k"]
    coarse_ids: SmallIds | None
    inverse_norms: Numbers

    kind = "pq"

    def __post_init__(self) -> None:
        norms, grouped = self.inverse_norms, self.grouped
        if norms.ndim != 1 or norms.dtype != np.float32:
            raise InputError(f"inverse_norms: expected float32 (n), got {norms.dtype} {norms.shape}")
        if not (np.isfinite(norms).all() and (norms >= 0).all()):
            raise InputError("inverse_norms: expected finite numbers of 0 or more")
        groups, subvectors = -(-len(norms) // GROUP_ROWS), self.codebook.num_subvectors
        if grouped.dtype != np.uint8 or grouped.shape != (groups, subvectors, GROUP_ROWS):
            raise InputError(
                f"grouped codes: expected uint8 ({groups}, {subvectors}, {GROUP_ROWS}) for {len(norms)} rows, "
                f"got {grouped.dtype} {grouped.shape}"
            )
        self.codebook.check_coarse_ids(self.coarse_ids, len(norms))

    def __len__(self) -> int:
        return len(self.inverse_norms)

    @property
    def dim(self) -> int:
        return self.codebook.dim

    @property
    def nbytes(self) -> int:
        ids = self.coarse_ids
        return self.grouped.nbytes + self.inverse_norms.nbytes + (0 if ids is None else ids.nbytes)

    def scores(self, queries: Embeddings, *, threads: int = 0) -> FloatRows:
        """See Code. The error is at most 1e-4."""
        batches = [self._scan_scores(tables, self._exact(threads)) for tables in self._tables(queries, threads)]
        if len(batches) == 1:
            return batches[0]
        return np.concatenate([np.empty((0, len(self)), np.float32), *batches])

    def select(self, query: Embedding, threshold: float, floor: Numbers | None = None, *, threads: int = 0) -> Hits:
        """See Code."""
        tables = self.codebook.tables(query[None], threads=threads)
        return self._scan_above(tables, threshold, floor, self._exact(threads))

    def top(self, query: Embedding, count: int, *, threads: int = 0) -> Hits:
        """See Code. Raises: InputError: a count below 1."""
        tables = self.codebook.tables(query[None], threads=threads)
        return self._scan_top(tables, count, self._exact(threads))

    def best(self, queries: Embeddings, *, threads: int = 0) -> Best:
        """See Code. More than 16 queries: scores are off by up to 2e-3 (six standard deviations).

        Raises: InputError: no queries.
        """
        if not len(queries):
            raise InputError("expected one or more queries to choose from")
        how = self._exact(threads) if len(queries) <= MAX_EXACT_QUERIES else self._hybrid(threads)
        best: Best | None = None
        for number, tables in enumerate(self._tables(queries, threads)):
            batch = self._scan_best(tables, how)
            best = batch if best is None else _better(best, batch, number * BATCH_QUERIES)
        assert best is not None
        return best

    def decode(self, rows: WholeNumbers) -> Embeddings:
        """See Code."""
        decoded = self.codebook.decode(self.codes(rows))
        return decoded * self.inverse_norms[rows, None]

    def codes(self, rows: WholeNumbers | None = None) -> Codes:
        """Return plain codes of some rows or all, one row after the other, to export or decode them."""
        index = np.arange(len(self)) if rows is None else np.arange(len(self))[rows]
        ids = self.coarse_ids
        return Codes(rows_of_groups(self.grouped, index), None if ids is None else ids[index])

    def rows(self, index: WholeNumbers) -> "PQCode":
        """See Code."""
        return pq_code(self.codebook, self.codes(index), self.inverse_norms[index])

    def run(self, begin: int, end: int) -> "PQCode":
        """See Code."""
        check_run(begin, GROUP_ROWS)
        groups, ids = self.grouped[begin // GROUP_ROWS : -(-end // GROUP_ROWS)], self.coarse_ids
        part = PQCode(self.codebook, groups, None if ids is None else ids[begin:end], self.inverse_norms[begin:end])
        part.__dict__["_scale"] = self._scale
        return part

    def tensors(self) -> Arrays:
        """See Code."""
        arrays = {"grouped_codes": self.grouped, "inverse_norms": self.inverse_norms}
        if self.coarse_ids is not None:
            arrays["coarse_ids"] = self.coarse_ids
        return arrays | self.codebook.tensors()

    @property
    def _rows(self) -> GroupedRows:
        return GroupedRows(self.grouped, self.inverse_norms, self.coarse_ids)

    def _scan_scores(self, tables: QueryTables, how: Scanning) -> FloatRows:
        return scan_scores(self._rows, tables, how)

    def _scan_above(self, tables: QueryTables, threshold: float, floor: Numbers | None, how: Scanning) -> Hits:
        return Hits(*scan_above(self._rows, tables, threshold, floor, how))

    def _scan_top(self, tables: QueryTables, count: int, how: Scanning) -> Hits:
        return Hits(*scan_top(self._rows, tables, count, how))

    def _scan_best(self, tables: QueryTables, how: Scanning) -> Best:
        return Best(*scan_best(self._rows, tables, how))

    def _tables(self, queries: Embeddings, threads: int) -> Iterator[QueryTables]:
        for begin in range(0, len(queries), BATCH_QUERIES):
            yield self.codebook.tables(queries[begin : begin + BATCH_QUERIES], threads=threads)

    @cached_property
    def _scale(self) -> float:
        """Largest factor from the error of a sum of look-ups to that of a score."""
        return float(np.clip(self.inverse_norms.max(initial=1.0), 1.0, MAX_TABLE_SCALE))

    def _exact(self, threads: int) -> Scanning:
        return Scanning(MAX_SCORE_ERROR / self._scale, 0, threads)

    def _hybrid(self, threads: int) -> Scanning:
        wide = max(1, min(HYBRID_WIDE_SUBVECTORS, self.codebook.num_subvectors // 4))
        return Scanning(HYBRID_SCORE_ERROR / self._scale, wide, threads)


def pq_code(codebook: Codebook, codes: Codes, inverse_norms: Numbers | None = None) -> PQCode:
    """Return codes as a code that can be searched. inverse_norms: computed if None.

    Raises: InputError: codes of another codebook.
    """
    codebook.check(codes)
    if inverse_norms is None:
        inverse_norms = codebook.inverse_norms(codes)
    return PQCode(codebook, group_codes(codes.codes), codes.coarse_ids, inverse_norms)


def _better(first: Best, second: Best, offset: int) -> Best:
    """Return the best of two batches of queries, the first of equals."""
    later = second.scores > first.scores
    index = np.where(later, second.index + np.int32(offset), first.index)
    scores = np.maximum(first.scores, second.scores)
    beaten = np.minimum(first.scores, second.scores)
    runner_up = np.maximum(np.maximum(first.runner_up, second.runner_up), beaten)
    return Best(index, scores, runner_up)
