"""Kernels of the mixture code (native): choosing the atoms of a feature, and scanning the rows.

Encoding gives the same bits at any number of threads. Scans add integers: their scores have the same bits at any number
of threads and of queries in a call, and on any instruction set.

threads: 0 for all cores. isa: an instruction set of `available_isas()`, or "" for the best one.
"""

from typing import NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import (
    ByteRows,
    Embedding,
    Embeddings,
    Float16,
    Float32,
    FloatRows,
    Ids,
    Indices,
    Int8,
    Int32,
    Numbers,
    OtherEmbeddings,
    OtherIds,
    OtherIndices,
    RowIds,
    UInt8,
    UInt16,
)
from ..errors import InputError
from .splats import checked_isa, native, native_array

ROWS_PER_BLOCK = 64
MAX_ATOMS_PER_ROW = 16
MAX_ATOMS = 1 << 16  # that a 16-bit id can name


class Dictionary(NamedTuple):
    """Unit vectors as signed bytes: atom = scale * values."""

    values: Int8[np.ndarray, "n D"]
    scales: Numbers


class Encoded(NamedTuple):
    """Encoded rows, heaviest atom first; scale * sum of weight * atom is a unit vector."""

    ids: Int32[np.ndarray, "n k"]
    weights: ByteRows
    scales: Numbers


class Blocks(NamedTuple):
    """Rows laid out for scans: within a block of 64 rows, the k-th ids of all rows lie together."""

    ids: UInt16[np.ndarray, "b k r"]
    weights: UInt8[np.ndarray, "b k r"]
    scales: Float16[np.ndarray, " n"]


class Candidates(NamedTuple):
    """Atoms that each row may be mixed from.

    indptr, columns: atoms of each row, in CSR form. further: more atoms, equally many for each row.
    """

    indptr: RowIds
    columns: OtherIds
    further: Int32[np.ndarray, "n f"]


def mixture_encode(
    features: Embeddings,
    dictionary: Dictionary,
    candidates: Candidates,
    atoms_per_row: int,
    *,
    threads: int = 0,
    isa: str = "",
) -> Encoded:
    """Choose up to `atoms_per_row` candidates whose mixture with positive weights comes nearest to a feature.

    Atoms are chosen by greedy orthogonal least squares; then each is replaced once by the candidate that fits best in
    its place. Rows for which no candidate has a positive weight become zero.

    Raises: InputError: shapes that disagree, candidates that are not in the dictionary, more than `MAX_ATOMS_PER_ROW`.
    Source: Chen, Billings & Luo 1989 (orthogonal least squares).
    """
    if not np.isfinite(features).all():
        raise InputError("features to encode must be finite")
    starts = np.ascontiguousarray(candidates.indptr, np.int64)
    arrays = (*dictionary, features, starts, *candidates[1:])
    return Encoded(*native("mixture_encode", _native.mixture_encode, *arrays, atoms_per_row, threads, checked_isa(isa)))


def nearest_centres(points: Embeddings, centres: OtherEmbeddings, *, threads: int = 0, isa: str = "") -> Ids:
    """Return the centre that has the largest inner product with each point; the lowest index wins ties.

    Raises: InputError: no centres, or of another dimension.
    """
    return native_array("nearest_centres", _native.nearest_centres, points, centres, threads, checked_isa(isa))


def nearest_members(
    points: Embeddings,
    dictionary: Dictionary,
    groups: Ids,
    members: Int32[np.ndarray, "g m"],
    wanted: int,
    *,
    threads: int = 0,
    isa: str = "",
) -> Int32[np.ndarray, "n w"]:
    """Return the `wanted` atoms with the largest inner products with each point, among its group's members.

    Raises: InputError: groups or members that do not exist, or fewer members than wanted.
    """
    given = *dictionary, points, groups, members, wanted, threads, checked_isa(isa)
    return native_array("nearest_members", _native.nearest_members, *given)


def mixture_scores(
    blocks: Blocks, dictionary: Dictionary, queries: Embeddings, *, threads: int = 0, isa: str = ""
) -> FloatRows:
    """Return scale_i * sum_k weight_ik * <query, atom of id_ik>, with <query, atom> rounded to steps of 1 / 32767.

    Raises: InputError: shapes disagree, or a query that is not finite.
    """
    arrays = _scan_arrays(blocks, dictionary), _finite(queries)
    return native_array("mixture_scores", _native.mixture_scores, *arrays, threads, checked_isa(isa))


def mixture_select(
    blocks: Blocks,
    dictionary: Dictionary,
    query: Embedding,
    threshold: float,
    floor: Numbers | None = None,
    *,
    threads: int = 0,
    isa: str = "",
) -> tuple[OtherIndices, Float32[np.ndarray, " m"]]:
    """Return the rows with score - floor > threshold, ascending, and their scores.

    Raises: InputError: shapes disagree, or a query that is not finite.
    """
    arguments = _scan_arrays(blocks, dictionary), _finite(query), threshold, floor
    rows, scores = native("mixture_select", _native.mixture_select, *arguments, threads, checked_isa(isa))
    return rows.view(np.int64), scores  # the native dtype may be "long long"


def mixture_top(
    blocks: Blocks, dictionary: Dictionary, query: Embedding, count: int, *, threads: int = 0, isa: str = ""
) -> tuple[Indices, Numbers]:
    """Return the `count` rows with the highest scores, best first, and these scores; the lower row wins ties.

    Raises: InputError: shapes disagree, a count below 1, or a query that is not finite.
    """
    if count < 1:
        raise InputError(f"count: expected 1 or more, got {count}")
    arguments = _scan_arrays(blocks, dictionary), _finite(query), count
    rows, scores = native("mixture_top", _native.mixture_top, *arguments, threads, checked_isa(isa))
    return rows.view(np.int64), scores  # the native dtype may be "long long"


def mixture_best(
    blocks: Blocks, dictionary: Dictionary, queries: OtherEmbeddings, *, threads: int = 0, isa: str = ""
) -> tuple[Ids, Numbers, Numbers]:
    """Return for each row the query with the highest score (the first wins ties), that score, and the next highest.

    Raises: InputError: shapes disagree, no query, or one that is not finite.
    """
    arrays = _scan_arrays(blocks, dictionary), _finite(queries)
    index, scores, runner_up = native("mixture_best", _native.mixture_best, *arrays, threads, checked_isa(isa))
    return index, scores, runner_up


def _scan_arrays(blocks: Blocks, dictionary: Dictionary) -> tuple[np.ndarray, ...]:
    ids, weights, scales = blocks
    return ids, weights, np.ascontiguousarray(scales).view(np.uint16), *dictionary


def _finite(queries: np.ndarray) -> np.ndarray:
    if not np.isfinite(queries).all():
        raise InputError("queries must be finite")
    return queries
