"""A few embeddings that say what a node looks like: spherical k-means of those of its masks, all nodes at once.

One mean of a mug's front and back fits neither as well as two do.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float32, Int64
from ...kernels import weighted_rows
from ..forest import MAX_DESCRIPTORS_PER_NODE
from .heaviest import heaviest

MAX_MASKS_CLUSTERED = 64  # of a node, those of the largest weights
ALIKE_COSINE = 0.8  # what is as near as this to a centre needs none of its own
MIN_CLUSTER_SHARE = 0.05  # of a node's weight: masks with less together are left out
LLOYD_ROUNDS = 4  # after each new centre
ENTRIES_AT_ONCE = 4096


def descriptors(
    weights: csr_array, embeddings: Float32[np.ndarray, "M D"], *, threads: int = 0
) -> tuple[Int64[np.ndarray, " T1"], Float32[np.ndarray, "P D"]]:
    """Return up to four unit vectors for each row of `weights` (T, M), as row starts and vectors, the heaviest first.

    The first centre is the weighted mean; a further one starts from the mask that is served worst, weight times
    (1 - cosine), as long as one is unlike all centres. The same bits at any number of threads.
    """
    clusters = _Clusters(heaviest(weights, MAX_MASKS_CLUSTERED), embeddings, threads)
    labels = np.zeros(clusters.weights.nnz, np.int64)
    part = np.arange(len(labels))  # entries of rows that may need more
    for count in range(1, MAX_DESCRIPTORS_PER_NODE):
        far = part[clusters.worst_served(part, clusters.cosines(labels, part, count).max(axis=1, initial=-1))]
        needing = np.zeros(weights.shape[0], bool)
        needing[clusters.rows[far]] = True
        part = part[needing[clusters.rows[part]]]
        labels[far] = count
        clusters.settle(labels, part, count + 1)
    return clusters.centers(labels)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Up to MAX_DESCRIPTORS_PER_NODE clusters in each row. weights: (T, M), with the entries that are put into them.

    labels: the cluster of each entry, counted in its row. part: numbers of some of the entries.
    """

    weights: csr_array
    embeddings: Float32[np.ndarray, "M D"]
    threads: int

    @cached_property
    def rows(self) -> Int64[np.ndarray, " e"]:
        return np.repeat(np.arange(self.weights.shape[0]), np.diff(self.weights.indptr))

    def settle(self, labels: Int64[np.ndarray, " e"], part: Int64[np.ndarray, " p"], count: int) -> None:
        """Move the entries of `part` to the cluster of the nearest centre, the first of equal ones, in some rounds."""
        for _ in range(LLOYD_ROUNDS):
            nearest = self.cosines(labels, part, count).argmax(axis=1)
            if (nearest == labels[part]).all():
                break
            labels[part] = nearest

    def worst_served(
        self, part: Int64[np.ndarray, " p"], cosines: Float32[np.ndarray, " p"]
    ) -> Int64[np.ndarray, " t"]:
        """Return the place of each row's worst served entry of `part`, among those that are unlike all centres."""
        served = np.where(cosines < ALIKE_COSINE, self.weights.data[part] * (1 - cosines.astype(np.float64)), 0)
        rows = self.rows[part]
        most = np.zeros(self.weights.shape[0])
        np.maximum.at(most, rows, served)
        (worst,) = np.nonzero((served > 0) & (served == most[rows]))
        return np.asarray(worst[np.diff(rows[worst], prepend=-1) > 0])

    def means(self, labels: Int64[np.ndarray, " e"]) -> Float32[np.ndarray, "T k D"]:
        """Return the unit mean of each cluster, zero where it has no entries or they cancel out."""
        clusters = self.rows * MAX_DESCRIPTORS_PER_NODE + labels
        order = np.argsort(clusters, kind="stable")
        count = self.weights.shape[0] * MAX_DESCRIPTORS_PER_NODE
        starts = np.append(0, np.cumsum(np.bincount(clusters, minlength=count)))
        data = self.weights.data[order].astype(np.float32)
        means = weighted_rows(
            starts, self.weights.indices[order], data, self.embeddings, 0, count, threads=self.threads
        )
        return means.reshape(-1, MAX_DESCRIPTORS_PER_NODE, means.shape[1])

    def cosines(
        self, labels: Int64[np.ndarray, " e"], part: Int64[np.ndarray, " p"], count: int
    ) -> Float32[np.ndarray, "p k"]:
        """Return the cosines of the entries of `part` with the first `count` centres of their rows, -1 with empty ones.

        BLAS is avoided: its bits depend on the number of its threads.
        """
        means = self.means(labels)
        filled = np.asarray(means.any(axis=2))
        cosines = np.empty((len(part), count), np.float32)
        for begin in range(0, len(part), ENTRIES_AT_ONCE):
            entries = part[begin : begin + ENTRIES_AT_ONCE]
            rows, own = self.rows[entries], self.embeddings[self.weights.indices[entries]]
            for k in range(count):
                row_cosines = np.einsum("ed,ed->e", own, means[rows, k])
                cosines[begin : begin + ENTRIES_AT_ONCE, k] = np.where(filled[rows, k], row_cosines, -1)
        return cosines

    def centers(self, labels: Int64[np.ndarray, " e"]) -> tuple[Int64[np.ndarray, " T1"], Float32[np.ndarray, "P D"]]:
        """Return the row starts and unit means, the heaviest cluster of each row first, without specks."""
        means = self.means(labels)
        shape = means.shape[:2]
        clusters = self.rows * MAX_DESCRIPTORS_PER_NODE + labels
        mass = np.bincount(clusters, self.weights.data, shape[0] * shape[1]).reshape(shape)
        mass[~means.any(axis=2) | (mass < MIN_CLUSTER_SHARE * mass.sum(axis=1, keepdims=True))] = 0
        order = np.argsort(-mass, axis=1, kind="stable")
        sorted_means = np.take_along_axis(means, order[..., None], axis=1)
        filled = np.take_along_axis(mass, order, axis=1) > 0
        return np.append(0, np.cumsum(filled.sum(axis=1))), np.asarray(sorted_means[filled])
