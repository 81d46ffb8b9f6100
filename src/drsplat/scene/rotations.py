"""Unit quaternions (w, x, y, z) to matrices."""

import numpy as np

from ..base.arrays import Anywhere, Float


def rotation_matrices(quats: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the matrices from local axes (their columns) to the world, in the precision of the input."""
    matrices: np.ndarray = np.stack([np.stack(row, -1) for row in rotation_rows(quats.T)], -2)
    return matrices


def rotation_rows(quats: Float[Anywhere, "4 n"]) -> list[list[Float[Anywhere, " n"]]]:
    """Return the entries of `rotation_matrices` as three rows of three arrays, each over all quaternions."""
    w, x, y, z = quats
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
