"""Unit quaternions (w, x, y, z) to matrices."""

import numpy as np

from ..arrays import Float


def rotation_matrices(quats: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 3 3"]:
    """From local axes, its columns, to the world; in the precision given."""
    matrices: np.ndarray = np.stack([np.stack(row, -1) for row in rotation_rows(quats.T)], -2)
    return matrices


def rotation_rows(quats: Float[np.ndarray, "4 n"]) -> list[list[Float[np.ndarray, " n"]]]:
    """The numbers of the matrices of `rotation_matrices`, each of all together: three rows of three."""
    w, x, y, z = quats
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
