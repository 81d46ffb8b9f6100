"""Quaternions (w, x, y, z) of any length, acting on vectors row by row; on arrays of NumPy or of a device.

Written out, because libraries contract products of small matrices in orders and precisions of their own.
"""

import numpy as np

from ..base.arrays import Anywhere, Float32
from ..scene.gaussians import rotation_rows


def unit(quats: Float32[Anywhere, "n 4"]) -> Float32[Anywhere, "n 4"]:
    w, x, y, z = quats.T
    unit: Anywhere = quats / np.sqrt(w * w + x * x + y * y + z * z)[:, None]
    return unit


def rotated(quats: Float32[Anywhere, "n 4"], vectors: Float32[Anywhere, "n 3"]) -> Float32[Anywhere, "n 3"]:
    """Rotate vectors from the local axes of each row to the world."""
    x, y, z = vectors.T
    turned: Anywhere = np.stack([a * x + b * y + c * z for a, b, c in rotation_rows(unit(quats).T)], -1)
    return turned


def spread(
    quats: Float32[Anywhere, "n 4"], scales: Float32[Anywhere, "n 3"], vectors: Float32[Anywhere, "n 3"]
) -> Float32[Anywhere, "n 3"]:
    """Return the covariance times vector: R S S^T R^T v."""
    rows = rotation_rows(unit(quats).T)
    x, y, z = vectors.T
    local = [(rows[0][k] * x + rows[1][k] * y + rows[2][k] * z) * scales[:, k] ** 2 for k in range(3)]
    world: Anywhere = np.stack([a * local[0] + b * local[1] + c * local[2] for a, b, c in rows], -1)
    return world
