"""The heaviest entries of each row of a sparse matrix."""

import numpy as np
from scipy.sparse import csr_array


def heaviest(matrix: csr_array, most: int) -> csr_array:
    """Up to `most` entries of each row, the heaviest first, of equal ones the first column first."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    order = np.lexsort((matrix.indices, -matrix.data, rows))
    kept = order[np.arange(len(order)) - matrix.indptr[rows] < most]
    starts = np.append(0, np.cumsum(np.minimum(np.diff(matrix.indptr), most)))
    return csr_array((matrix.data[kept], matrix.indices[kept], starts), shape=matrix.shape)
