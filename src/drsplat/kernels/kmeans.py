"""K-means of all sub-vectors at once: Lloyd's algorithm on the native encoder.

The same points and seed give the same bits for any number of threads.
"""

from dataclasses import dataclass

import numpy as np

from ..base.arrays import Arrays, Embeddings, Float32, Int, UInt64
from ..base.working import HERE, Held, Work
from .algebra import CENTROIDS, code_sums, pq_encode

KMEANS_STEPS = 12
SUBVECTORS_AT_ONCE = 16


def train_centroids(
    points: Embeddings, num_subvectors: int, seed: int, work: Work = HERE
) -> Float32[np.ndarray, "L c d"]:
    """Train 256 centroids per sub-vector; one of at most 256 distinct values gets exactly those.

    Starts from distinct points. A centroid that serves no point moves to the worst-served one.

    Source: Jegou et al. 2011; Lloyd 1982.
    """
    rng = np.random.default_rng(seed)
    starts = np.stack([_starts(keys, rng) for keys in _keys(points.reshape(len(points), num_subvectors, -1)).T])
    spans = [
        (begin, min(begin + SUBVECTORS_AT_ONCE, num_subvectors))
        for begin in range(0, num_subvectors, SUBVECTORS_AT_ONCE)
    ]
    part = Centroids(work.hold({"points": points, "starts": starts}))
    return np.concatenate([held.arrays["centroids"] for held in work(part, spans, "training the codebook")])


@dataclass(frozen=True, eq=False)
class Centroids:
    """Trains the centroids of a span of sub-vectors: a `Part`. given: points, and of which centroids start from."""

    given: Held

    def __call__(self, span: tuple[int, int], threads: int) -> Arrays:
        starts, points = (self.given.arrays[name] for name in ("starts", "points"))
        count, width = span[1] - span[0], points.shape[1] // len(starts)
        points = np.ascontiguousarray(points[:, span[0] * width : span[1] * width])
        parts = points.reshape(len(points), count, width)
        centroids = np.stack([parts[index, m] for m, index in enumerate(starts[span[0] : span[1]])])
        previous = None
        for _ in range(KMEANS_STEPS):
            codes = pq_encode(points, centroids, threads=threads)
            if previous is not None and np.array_equal(codes, previous):
                break
            # move each centroid to the mean of its points, in place
            sums, counts = code_sums(points, codes, threads=threads)
            served = counts > 0
            centroids[served] = sums[served] / counts[served][:, None]
            for m in np.flatnonzero(~served.all(1)):
                # put centroids that serve no point on those that are served worst; copies gain nothing
                columns = np.ascontiguousarray(parts[:, m].T, np.float64)
                distances = ((columns - centroids[m][codes[:, m]].T) ** 2).sum(0)
                idle = np.flatnonzero(~served[m])
                worst = np.argsort(-distances, kind="stable")[: len(idle)]
                worst = worst[distances[worst] > 0]
                centroids[m, idle[: len(worst)]] = columns[:, worst].T
            previous = codes
        return {"centroids": centroids}


def _keys(parts: Float32[np.ndarray, "n L d"]) -> UInt64[np.ndarray, "n L"]:
    """Return a 64-bit hash of each sub-vector: equal for equal values."""
    keys = np.zeros(parts.shape[:2], np.uint64)
    for number in range(parts.shape[2]):
        word = (parts[:, :, number] + np.float32(0)).view(np.uint32)  # + 0 makes -0 equal 0
        keys ^= word
        keys *= np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    return keys


def _starts(keys: UInt64[np.ndarray, " n"], rng: "np.random.Generator") -> Int[np.ndarray, " c"]:
    """Draw 256 points of distinct values; where there are fewer, take all and repeat the first."""
    distinct = np.sort(np.unique(keys, return_index=True)[1])
    if len(distinct) <= CENTROIDS:
        return np.pad(distinct, (0, CENTROIDS - len(distinct)), constant_values=distinct[0])
    return np.sort(rng.choice(distinct, CENTROIDS, replace=False))
