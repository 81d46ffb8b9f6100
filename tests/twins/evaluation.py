"""Slow twins in float64, a line or two per equation: the fast functions are tested against them."""

import numpy as np

from drsplat.base.arrays import Float64, Matrices, RowIds, WholeNumbers
from drsplat.scene.gaussians import Gaussians

Positions = Float64[np.ndarray, "m 3"]


def squared_distances(gaussians: Gaussians, positions: Positions) -> Float64[np.ndarray, "n m"]:
    """Return the squared Mahalanobis distances of all pairs.  Source: Dr. Splat Eq. 1."""
    offsets = positions[None] - gaussians.means.astype(np.float64)[:, None]
    inverse = np.linalg.inv(_matrices(gaussians))
    distances: np.ndarray = np.einsum("nmi,nij,nmj->nm", offsets, inverse, offsets)
    return distances


def density_votes(
    gaussians: Gaussians, positions: Positions, labels: RowIds, cut_off: float
) -> Float64[np.ndarray, "n s"]:
    """Return the sum of exp(-d^2 / 2) over the near points of each label 0 to max(labels)."""
    squared = squared_distances(gaussians, positions)
    votes = np.where(squared <= cut_off**2, np.exp(-squared / 2), 0)
    return np.stack([votes[:, labels == s].sum(1) for s in range(int(labels.max()) + 1)], axis=1)


def density_labels(gaussians: Gaussians, positions: Positions, labels: RowIds, cut_off: float) -> WholeNumbers:
    votes = density_votes(gaussians, positions, labels, cut_off)
    return np.where(votes.any(1), votes.argmax(1), -1)


def printed_labels(gaussians: Gaussians, positions: Positions, labels: RowIds) -> WholeNumbers:
    """Return the argmax over labels of the sum of squared distances.  Source: Dr. Splat Eq. 2."""
    squared = squared_distances(gaussians, positions)
    names = np.unique(labels)
    sums = np.stack([squared[:, labels == s].sum(1) for s in names], axis=1)
    return np.asarray(names[sums.argmax(1)])


def voxel_scores(
    gaussians: Gaussians, labels: WholeNumbers, voxels: Positions, num_labels: int, cut_off: float
) -> Float64[np.ndarray, "v s"]:
    """Return the sum over i of alpha_i 1{label_i = s} N(v | mu_i, Sigma_i).  Source: Dr. Splat Eq. 4."""
    squared = squared_distances(gaussians, voxels)
    norms = np.sqrt(np.linalg.det(2 * np.pi * _matrices(gaussians)))
    density = np.where(squared <= cut_off**2, np.exp(-squared / 2), 0) / norms[:, None]
    mass = gaussians.opacities.astype(np.float64)[:, None] * density
    return np.stack([mass[labels == s].sum(0) for s in range(num_labels)], axis=1)


def _matrices(gaussians: Gaussians) -> Matrices:
    full = np.empty((len(gaussians), 3, 3))
    rows, columns = np.triu_indices(3)
    full[:, rows, columns] = full[:, columns, rows] = gaussians.covariances()
    return full
