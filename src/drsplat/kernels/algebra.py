"""The algebra of embedding and after registration (native; float32): products of matrices, rows of W @ E, codes.

Every function is the same to the bit for any number of threads; `threads=0` takes all cores and
`isa` names an instruction set of `available_isas()`, "" the best.
"""

import numpy as np

from .. import _native
from ..base.arrays import (
    ByteRows,
    Embeddings,
    Float,
    Float32,
    Float64,
    FloatRows,
    Ids,
    Int32,
    Int64,
    Integer,
    Numbers,
    OtherEmbeddings,
    OtherIds,
    OtherIndices,
    UnsignedIds,
    WholeNumbers,
)
from ..errors import InputError
from .splats import checked_isa, native, native_array

CENTROIDS = 256
LANES = 16  # numbers per step of the native code
Entries = tuple[np.ndarray, np.ndarray, np.ndarray]  # row starts, columns and float32 numbers of CSR


def weighted_rows(
    indptr: Integer[np.ndarray, " n1"],
    indices: WholeNumbers,
    data: Numbers,
    embeddings: OtherEmbeddings,
    begin: int,
    end: int,
    *,
    threads: int = 0,
    isa: str = "",
) -> Float32[np.ndarray, "b D"]:
    """Return rows [begin, end) of W @ E, each divided by its L2 norm; a row of zero norm stays zero.

    W is CSR (indptr, indices, data). Nothing but the result is allocated: `embeddings` may be a
    memory map, and W may have any number of rows.

    Raises: InputError: no such rows, or a damaged W (row starts that fall, columns out of range).
    Source: Dr. Splat Sec. A "Training stage" (dividing by the sum of weights changes no direction).
    """
    if not 0 <= begin <= end < len(indptr):
        raise InputError(f"rows {begin}:{end} asked of a matrix of {len(indptr) - 1} rows")
    starts = np.ascontiguousarray(indptr[begin : end + 1], np.int64)
    low, high = int(starts[0]), int(starts[-1])
    if not 0 <= low <= high <= len(indices) or len(indices) != len(data) or (np.diff(starts) < 0).any():
        raise InputError(f"rows {begin}:{end}: row starts do not fit {len(indices)} columns, {len(data)} weights")
    arrays = starts - low, np.asarray(indices[low:high], np.int32), data[low:high], embeddings
    what, got = f"rows {begin}:{end}", f"; there are {len(embeddings)} embeddings"
    return native_array(what, _native.weighted_rows, *arrays, threads, checked_isa(isa), got=got)


def dense_rows(
    a: FloatRows, b: Float32[np.ndarray, "k m"], *, threads: int = 0, isa: str = ""
) -> Float32[np.ndarray, "n m"]:
    """Return A @ B, to the same bits for any number of threads or rows, unlike a BLAS.

    Raises: InputError: A has not as many columns as B has rows.
    """
    width = b.shape[1]
    columns = np.pad(b, ((0, 0), (0, -width % LANES)))
    try:
        product = _native.dense_rows(np.ascontiguousarray(a), np.ascontiguousarray(columns), threads, checked_isa(isa))
    except ValueError:
        raise InputError(f"expected matrices (n, k) and (k, m), got {a.shape} and {b.shape}") from None
    return np.asarray(product)[:, :width]


def row_products(rows: Float[np.ndarray, "n d"], vector: Float[np.ndarray, " d"]) -> Float[np.ndarray, " n"]:
    """Return each row's inner product with a vector, to the same bits wherever it is computed, unlike a BLAS.

    A BLAS cuts long sums and many rows into a part for each of its threads, and each part ends in a sum of its own.
    """
    return np.einsum("nd,d->n", rows, vector)


def convolve(
    images: Float32[np.ndarray, "n h w c"],
    weight: Float32[np.ndarray, "k o"],
    bias: Float32[np.ndarray, " o"],
    stride: int = 1,
    *,
    threads: int = 0,
    isa: str = "",
) -> Float32[np.ndarray, "n _ _ o"]:
    """Return a 3x3 convolution and ReLU, with one pixel of zeros around each image.

    weight: (9 * c, o), rows in the order of row, column, channel.

    Raises: InputError: weights or a bias for other images, or no stride.
    """
    outputs = weight.shape[1]
    beyond = -outputs % LANES
    columns, added = np.pad(weight, ((0, 0), (0, beyond))), np.pad(bias, (0, beyond))
    got = f"; got images {images.shape}, weights {weight.shape}, a bias {bias.shape}, stride {stride}"
    given = images, columns, added, stride, threads, checked_isa(isa)
    return native_array("convolution", _native.convolve, *given, got=got)[..., :outputs]


def changed_columns(
    weights: Entries, numbers: OtherIds, added: Entries, *, threads: int = 0
) -> tuple[OtherIndices, Ids, Numbers]:
    """Renumber a CSR matrix's columns and add another's entries; return row starts, columns, numbers.

    numbers: the new number of each column, ascending, or below 0: its entries are left out. Columns of a row ascend
    in both matrices, and then in the result.

    Raises: InputError: other rows in one than in the other, a damaged matrix, or columns without a number.
    """
    given = *_csr(weights), numbers, *_csr(added), threads
    starts, columns, values = native("columns", _native.changed_columns, *given)
    return starts.view(np.int64), columns, values  # it may come as "long long"


def place_entries(
    entries: tuple[UnsignedIds, Ids, Numbers], first_column: int, following: OtherIndices,
    columns: Int32[np.ndarray, " w"], weights: Float32[np.ndarray, " w"],
) -> None:  # fmt: skip
    """Put one view's entries (rows, columns, numbers) into the rows of a CSR matrix, in place.

    following: where the next entry of each row goes; it moves on. first_column: added to the entries' columns.

    Raises: InputError: there is no such row, or it has no room.
    """
    native("entries", _native.place_entries, *entries, first_column, following, columns, weights)


def _csr(entries: Entries) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    starts, columns, values = entries
    return np.asarray(starts, np.int64), np.asarray(columns, np.int32), values


def code_sums(
    points: Embeddings, codes: ByteRows, *, threads: int = 0
) -> tuple[Float64[np.ndarray, "k c d"], Int64[np.ndarray, "k c"]]:
    """Return the sum of the sub-vectors of each code, in the order of points, and how many they are.

    Raises: InputError: not one code per sub-vector.
    """
    got = f"; got {points.shape} and {codes.shape}"
    sums, counts = native("sums", _native.code_sums, points, codes, threads, got=got)
    return sums, counts.view(np.int64)  # it may come as "long long"


def pq_encode(
    features: Embeddings, centroids: Float32[np.ndarray, "k c d"], *, threads: int = 0, isa: str = ""
) -> ByteRows:
    """Return the nearest of 256 centroids (L2) for each of L sub-vectors, ties to the lowest index.

    Raises: InputError: centroids are not (L, 256, D / L), or features are not finite.
    Source: Jegou et al. 2011.
    """
    subvectors, count, dim = centroids.shape
    if count != CENTROIDS or subvectors * dim != features.shape[1] or dim == 0:
        raise InputError(
            f"features of {features.shape[1]} numbers cannot be coded with centroids "
            f"{centroids.shape}: expected (L, {CENTROIDS}, D / L)"
        )
    if not np.isfinite(features).all():
        raise InputError("features to encode must be finite")
    return native_array("codes", _native.pq_encode, features, centroids, threads, checked_isa(isa))
