"""Quaternions (w, x, y, z) of any length, acting on vectors row by row."""

import numpy as np
from jaxtyping import Float32


def rotation_matrices(quats: Float32[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 3 3"]:
    """The rotation of each quaternion after normalisation."""
    w, x, y, z = (quats / np.sqrt(np.einsum("ni,ni->n", quats, quats))[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrices: np.ndarray = np.stack([np.stack(row, -1) for row in rows], -2)
    return matrices


def rotated(
    quats: Float32[np.ndarray, "n 4"], vectors: Float32[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """From the local axes of each row to the world."""
    # einsum, not matmul: BLAS may round differently with another number of threads
    turned: np.ndarray = np.einsum("nij,nj->ni", rotation_matrices(quats), vectors)
    return turned


def spread(
    quats: Float32[np.ndarray, "n 4"],
    scales: Float32[np.ndarray, "n 3"],
    vectors: Float32[np.ndarray, "n 3"],
) -> Float32[np.ndarray, "n 3"]:
    """Covariance times vector: R S S^T R^T v."""
    axes = rotation_matrices(quats)
    local = np.einsum("nij,ni->nj", axes, vectors) * scales**2
    world: np.ndarray = np.einsum("nij,nj->ni", axes, local)
    return world
