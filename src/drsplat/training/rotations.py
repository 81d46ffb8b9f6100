"""Quaternions (w, x, y, z) of any length, acting on vectors row by row."""

import numpy as np

from ..arrays import Anywhere, Float32
from ..scene.rotations import rotation_matrices


def unit(quats: Float32[Anywhere, "n 4"]) -> Float32[Anywhere, "n 4"]:
    unit: Anywhere = quats / np.sqrt(np.einsum("ni,ni->n", quats, quats))[:, None]
    return unit


def rotated(quats: Float32[Anywhere, "n 4"], vectors: Float32[Anywhere, "n 3"]) -> Float32[Anywhere, "n 3"]:
    """Rotate vectors from the local axes of each row to the world."""
    # einsum, not matmul: BLAS may round differently with another number of threads
    turned: Anywhere = np.einsum("nij,nj->ni", rotation_matrices(unit(quats)), vectors)
    return turned


def spread(
    quats: Float32[Anywhere, "n 4"], scales: Float32[Anywhere, "n 3"], vectors: Float32[Anywhere, "n 3"]
) -> Float32[Anywhere, "n 3"]:
    """Covariance times vector: R S S^T R^T v."""
    axes = rotation_matrices(unit(quats))
    local = np.einsum("nij,ni->nj", axes, vectors) * scales**2
    world: Anywhere = np.einsum("nij,nj->ni", axes, local)
    return world
