"""The heaviest entries of each row of a sparse matrix."""

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float64


def heaviest(matrix: csr_array, most: int) -> csr_array:
    """Return up to `most` entries of each row, the heaviest first, of equal ones the first column first."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    (heavy,) = np.nonzero(matrix.data >= _bars(matrix, most)[rows])  # and more, where some are equal
    order = heavy[np.lexsort((matrix.indices[heavy], -matrix.data[heavy], rows[heavy]))]
    begins = np.searchsorted(rows[order], np.arange(matrix.shape[0]))
    kept = order[np.arange(len(order)) - begins[rows[order]] < most]
    starts = np.append(0, np.cumsum(np.minimum(np.diff(matrix.indptr), most)))
    return csr_array((matrix.data[kept], matrix.indices[kept], starts), shape=matrix.shape)


def _bars(matrix: csr_array, most: int) -> Float64[np.ndarray, " r"]:
    """Return the `most`-th largest weight of each row, -inf where it has no more than that."""
    bars = np.full(matrix.shape[0], -np.inf)
    for row in np.flatnonzero(np.diff(matrix.indptr) > most):
        data = matrix.data[matrix.indptr[row] : matrix.indptr[row + 1]]
        bars[row] = np.partition(data, len(data) - most)[len(data) - most]
    return bars
