"""The float64 twins of `kernels.scan`: slow, plain, and what the native kernels must compute."""

import numpy as np

from drsplat.base.arrays import Float, Float64, Indices, Int64
from drsplat.kernels.scan import GroupedRows, QueryTables, rows_of_groups


def lookup_tables(
    centroids: Float[np.ndarray, "L d c"], queries: Float[np.ndarray, "q D"]
) -> Float64[np.ndarray, "q L c"]:
    """The inner product of each part of each query with each centroid of that part."""
    parts = queries.astype(np.float64).reshape(len(queries), len(centroids), -1, 1)
    return np.asarray((parts * centroids.astype(np.float64)).sum(axis=2))


def scan_scores(rows: GroupedRows, tables: QueryTables) -> Float64[np.ndarray, "q n"]:
    """score_i = (sum_m lut[m, codes[i, m]] + coarse[coarse_ids[i]]) * inverse_norms[i]."""
    codes = rows_of_groups(rows.codes, np.arange(len(rows.inverse_norms)))
    every = np.arange(codes.shape[1])
    sums = np.array([lut.astype(np.float64)[every, codes].sum(axis=1) for lut in tables.luts])
    if tables.coarse is not None and rows.coarse_ids is not None:
        sums += tables.coarse.astype(np.float64)[:, rows.coarse_ids]
    return np.asarray(sums * rows.inverse_norms)


def above(
    scores: Float[np.ndarray, " n"], threshold: float, floor: Float[np.ndarray, " n"] | float = 0.0
) -> Int64[np.ndarray, " h"]:
    """Rows whose score minus `floor` exceeds the threshold, ascending."""
    return np.flatnonzero(scores - floor > threshold).astype(np.int64)


def top(scores: Float[np.ndarray, " n"], count: int) -> Int64[np.ndarray, " h"]:
    """The best rows, best first, ties to the lower row."""
    return np.argsort(-scores, kind="stable")[:count].astype(np.int64)


def best(scores: Float[np.ndarray, "q n"]) -> tuple[Indices, Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The query of the highest score of each row (ties to the first), that score, the next highest."""
    index = scores.argmax(axis=0)
    ordered = np.sort(np.vstack([np.full_like(scores[:1], -np.inf), scores]), axis=0)
    return index.astype(np.int64), ordered[-1], ordered[-2]
