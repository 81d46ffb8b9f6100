"""Labels of free Gaussians from labelled points, by a spatial index and never by all pairs.

The protocols use `pseudo_labels`: the vote of `density_labels`, and for small Gaussians between the points
the nearest one.

Source: Dr. Splat Sec. C, Eq. 1-2.
"""

from collections.abc import Iterator
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Doubles, Float, Ids, OtherIndices, Vector3, Vectors
from ..errors import InputError
from ..scene.gaussians import Gaussians

CUT_OFF_SIGMAS = 3.0
MAX_CANDIDATES = 8192  # points within reach of a Gaussian; it samples them where there are more
SAMPLING_STEP = 4  # in each round, one in so many points is kept for Gaussians with more candidates
MAX_PAIRS = 1 << 19  # of Gaussians with points, or with labels, that are in memory at once
MAX_SPACINGS = 3.0  # to the nearest point
SPACING_SAMPLE = 20_000


class LabelledPoints(NamedTuple):
    """World positions with a label >= 0 each; 0 is a label like the others here."""

    positions: Vectors
    labels: Ids

    def relative_to(self, origin: Vector3) -> "LabelledPoints":
        """Return the points counted from `origin`."""
        if not origin.any():
            return self
        return self._replace(positions=(self.positions - origin).astype(np.float32))


def pseudo_labels(gaussians: Gaussians, points: LabelledPoints, *, threads: int = 0) -> Ids:
    """Return the label of each Gaussian, -1 where no point is near enough.

    Where the density vote has no point within its cut-off, as with Gaussians smaller than the gaps
    between points, the nearest point decides, if it is within three spacings (`spacing`).

    Raises: InputError: as `density_labels`.
    """
    labels = density_labels(gaussians, points, threads=threads)
    points = points.relative_to(gaussians.origin)
    missing = np.flatnonzero(labels < 0)
    tree = cKDTree(points.positions)
    distances, nearest = tree.query(gaussians.means[missing], workers=threads or -1)
    near = distances <= MAX_SPACINGS * spacing(tree)
    labels[missing[near]] = points.labels[nearest[near]]
    return labels


def spacing(tree: cKDTree) -> float:
    """Return the 95th percentile of the points' distances to their nearest neighbours."""
    sample = tree.data[:: max(1, len(tree.data) // SPACING_SAMPLE)]
    distances, _ = tree.query(sample, k=min(2, len(tree.data)))
    return float(np.percentile(distances.reshape(len(sample), -1)[:, -1], 95))


def density_labels(
    gaussians: Gaussians, points: LabelledPoints, *, cut_off: float = CUT_OFF_SIGMAS, threads: int = 0
) -> Ids:
    """Return the argmax over labels s of the sum of exp(-d^2 / 2) over the points of s within `cut_off`.

    d is the Mahalanobis distance of a point to the Gaussian. The label is -1 where no point is that near; ties go
    to the lowest label. A Gaussian with more than 8192 points within its longest reach is judged by an even
    sample of at least 2048 of them. The same to the bit for any number of threads.

    Raises: InputError: no points, labels below 0, numbers that are not finite.
    Source: Dr. Splat Sec. C. Eq. 2 prints a sum of distances, which favours far and frequent labels.
    """
    if not len(points.labels) or len(points.labels) != len(points.positions):
        raise InputError(
            f"expected one label per point; got {len(points.positions)} points, {len(points.labels)} labels"
        )
    if points.labels.min() < 0:
        raise InputError(f"labels: expected 0 or more, got {points.labels.min()}")
    for name, array in (("points", points.positions), ("means", gaussians.means)):
        if not np.isfinite(array).all():
            raise InputError(f"{name}: expected finite positions")
    points = points.relative_to(gaussians.origin)
    present, dense = np.unique(points.labels, return_inverse=True)
    reach = (cut_off * (1 + 1e-6) * gaussians.scales.max(1)).astype(np.float64)
    whiten, winners = gaussians.whitening().astype(np.float32), np.full(len(gaussians), -1, np.int64)
    left, sample = np.arange(len(gaussians)), np.random.default_rng(0).permutation(len(dense))
    while len(left):
        positions, labels, means = points.positions[sample], dense[sample].astype(np.int64), gaussians.means[left]
        tree = cKDTree(positions)
        inside = tree.query_ball_point(means, reach[left], return_length=True, workers=threads or -1)
        few = left[inside <= MAX_CANDIDATES]
        for block, owner, at in near_pairs(tree, gaussians.means[few], reach[few], len(present), threads):
            ids = few[block]
            offsets = positions[at] - gaussians.means[ids][owner]
            squared = (np.einsum("pij,pj->pi", whiten[ids][owner], offsets) ** 2).sum(1)
            votes = np.where(squared <= np.float32(cut_off**2), np.exp(np.float32(-0.5) * squared), 0)
            sums = np.bincount(owner * len(present) + labels[at], votes, len(ids) * len(present))
            sums = sums.reshape(len(ids), len(present))
            winners[ids] = np.where(sums.any(1), sums.argmax(1), -1)
        left, sample = left[inside > MAX_CANDIDATES], sample[: -(-len(sample) // SAMPLING_STEP)]
    return np.append(present, -1).astype(np.int32)[winners]  # -1 stays -1


def near_pairs(
    tree: cKDTree, centers: Float[np.ndarray, "n 3"], reach: Doubles, width: int, threads: int
) -> Iterator[tuple[slice, OtherIndices, OtherIndices]]:
    """Yield all pairs of a centre and a point of a tree within its reach, for runs of centres that bound memory.

    Yields: the run, of each pair the number of its centre in it, and that of its point. width: further numbers that are
    in memory for each centre.
    """
    counts = tree.query_ball_point(centers, reach, return_length=True, workers=threads or -1)
    ends = np.flatnonzero(np.diff(np.cumsum(counts + width) // MAX_PAIRS)) + 1
    for begin, end in pairwise([0, *ends.tolist(), len(centers)]):
        near = tree.query_ball_point(centers[begin:end], reach[begin:end], workers=threads or -1)
        owner = np.repeat(np.arange(end - begin), counts[begin:end])
        yield slice(begin, end), owner, np.fromiter(chain.from_iterable(near), np.int64, len(owner))
