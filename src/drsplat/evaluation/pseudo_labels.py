"""Labels of free Gaussians from labelled points, by a spatial index and never by all pairs.

The protocols use `pseudo_labels`: the vote of `density_labels`, and for small Gaussians between the points
the nearest one.

Source: Dr. Splat Sec. C, Eq. 1-2.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Array, Doubles, Float32, Float64, Ids, Indices, OtherIds, OtherIndices, Vector3, Vectors
from ..errors import InputError
from ..scene.gaussians import Gaussians

CUT_OFF_SIGMAS = 3.0
MAX_CANDIDATES = 8192  # points in the box of a Gaussian; it samples them where there are more
SAMPLING_STEP = 4  # in each round, one in so many points is kept for Gaussians with more candidates
MAX_PAIRS = 1 << 19  # per batch: their arrays fit a core's cache
BLOCK_SOURCES = 8192
MAX_CELLS_ALONG = 1 << 16
MAX_SPACINGS = 3.0  # to the nearest point
SPACING_SAMPLE = 20_000
MAX_CELLS_PER_EXTENT = 1024  # boxes smaller than the extent over this are looked up like one of that size


class LabelledPoints(NamedTuple):
    """World positions with a label >= 0 each; 0 is a label like the others here."""

    positions: Vectors
    labels: Ids

    def relative_to(self, origin: Vector3) -> "LabelledPoints":
        """Return the points counted from `origin`."""
        if not origin.any():
            return self
        return self._replace(positions=(self.positions - origin).astype(np.float32))


class _Sources(NamedTuple):
    """Gaussians in the form of the vote: rows of `whiten` map offsets to standard deviations.

    reach: half sides of the box that holds the cut-off. size: its longest, up to a power of two.
    """

    ids: Indices
    means: Vectors
    whiten: Float32[Array, "n 9"]
    reach: Vectors
    size: Doubles

    def rows(self, index: Array | slice) -> "_Sources":
        return _Sources(*(column[index] for column in self))


class _Runs(NamedTuple):
    """Slices of the sorted points, by source."""

    owner: Indices
    starts: Indices
    counts: Indices


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
    to the lowest label. A Gaussian with more than 8192 points in its box is judged by an even
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
    names = np.append(present, -1).astype(np.int32)  # `winners` is -1 until there is a vote
    winners = np.full(len(gaussians), -1, np.int32)
    shuffled = np.random.default_rng(0).permutation(len(dense))
    extent = float(np.ptp(points.positions.astype(np.float64), axis=0).max())
    left = _sources(gaussians, cut_off, extent / MAX_CELLS_PER_EXTENT)
    while len(left.ids):
        sample = LabelledPoints(points.positions[shuffled], dense[shuffled].astype(np.int32))
        left = _vote_round(left, sample, cut_off, winners, threads)
        shuffled = shuffled[: -(-len(shuffled) // SAMPLING_STEP)]
    return names[winners]


def _sources(gaussians: Gaussians, cut_off: float, finest: float) -> _Sources:
    """Return the Gaussians in order of size, then of place, so that a block of them shares cells."""
    covariances = gaussians.covariances()
    reach = cut_off * np.sqrt(covariances[:, [0, 3, 5]])
    reach = (reach * (1 + 1e-6)).astype(np.float32)
    longest = np.maximum(reach.max(1).astype(np.float64), max(finest, 1e-12))
    size = np.exp2(np.ceil(np.log2(longest)))
    x, y, z = np.floor(gaussians.means.astype(np.float64) / size[:, None]).T
    order = np.lexsort((x, y, z, size))
    whiten = gaussians.whitening().astype(np.float32).reshape(-1, 9)
    return _Sources(order, gaussians.means[order], whiten[order], reach[order], size[order])


class _Grid:
    """Points sorted by cells of a cubic grid, x fastest: a run of cells along x is one slice."""

    def __init__(self, points: LabelledPoints, bounds: Float64[Array, "2 3"], cell: float) -> None:
        self.origin, extent = bounds[0], bounds[1] - bounds[0]
        self.cell = max(cell, float(extent.max()) / MAX_CELLS_ALONG, 1e-12)
        self.shape = (extent / self.cell).astype(np.int64) + 1
        at = ((points.positions - self.origin) / self.cell).astype(np.int64)
        keys = (at[:, 2] * self.shape[1] + at[:, 1]) * self.shape[0] + at[:, 0]
        order = np.argsort(keys, kind="stable")
        self.keys = keys[order]
        self.columns = [np.ascontiguousarray(points.positions[order, k]) for k in range(3)]
        self.labels = points.labels[order].astype(np.int64)
        self.num_labels = int(self.labels.max()) + 1

    def runs(self, sources: _Sources) -> _Runs:
        """Return the slices of points whose cells a source's box touches."""
        low, high = (
            np.floor((sources.means.astype(np.float64) + sign * sources.reach - self.origin) / self.cell)
            for sign in (-1, 1)
        )
        low, high = np.maximum(low, 0), np.minimum(high, self.shape - 1)
        spans = np.maximum(high - low + 1, 0).astype(np.int64)
        rows = np.where(spans[:, 0] > 0, spans[:, 1] * spans[:, 2], 0)
        owner = np.repeat(np.arange(len(rows)), rows)
        nth = np.arange(len(owner)) - np.repeat(np.cumsum(rows) - rows, rows)
        corner = low.astype(np.int64)[owner]
        y, z = corner[:, 1] + nth % spans[owner, 1], corner[:, 2] + nth // spans[owner, 1]
        first = (z * self.shape[1] + y) * self.shape[0] + corner[:, 0]
        starts = np.searchsorted(self.keys, first)
        counts = np.searchsorted(self.keys, first + spans[owner, 0]) - starts
        filled = counts > 0
        return _Runs(owner[filled], starts[filled], counts[filled])


def _vote_round(sources: _Sources, points: LabelledPoints, cut_off: float, winners: Ids, threads: int) -> _Sources:
    """Write the labels of Gaussians with few candidates; return the others."""
    corners = (points.positions.min(0), points.positions.max(0))
    bounds = np.stack(corners).astype(np.float64)
    bands = np.split(np.arange(len(sources.ids)), np.flatnonzero(np.diff(sources.size)) + 1)
    crowded = []
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        for band in bands:
            grid = _Grid(points, bounds, float(sources.size[band[0]]) / 2)
            blocks = [band[at : at + BLOCK_SOURCES] for at in range(0, len(band), BLOCK_SOURCES)]
            vote = partial(_vote_block, sources, grid, cut_off, winners)
            crowded += list(pool.map(vote, blocks))
    return sources.rows(np.concatenate(crowded))


def _vote_block(sources: _Sources, grid: _Grid, cut_off: float, winners: OtherIds, block: OtherIndices) -> Indices:
    """Write the labels of a block; return its rows with too many candidates."""
    inside = sources.rows(slice(block[0], block[-1] + 1))
    runs = grid.runs(inside)
    candidates = np.bincount(runs.owner, runs.counts, len(block)).astype(np.int64)
    few = candidates <= MAX_CANDIDATES
    runs = _Runs(*(column[few[runs.owner]] for column in runs))
    ends = np.cumsum(runs.counts)
    cuts = np.searchsorted(ends, np.arange(MAX_PAIRS, ends[-1] if len(ends) else 0, MAX_PAIRS))
    # a batch never divides a source's runs
    cuts = np.unique(np.searchsorted(runs.owner, runs.owner[cuts]))
    for begin, end in pairwise([0, *cuts.tolist(), len(runs.owner)]):
        if end > begin:
            _vote_batch(inside, grid, cut_off, winners, _Runs(*(c[begin:end] for c in runs)))
    return block[~few]


def _vote_batch(sources: _Sources, grid: _Grid, cut_off: float, winners: Ids, runs: _Runs) -> None:
    total = int(runs.counts.sum())
    shifts = runs.starts - (np.cumsum(runs.counts) - runs.counts)
    points = np.repeat(shifts, runs.counts) + np.arange(total)
    first, last = int(runs.owner[0]), int(runs.owner[-1]) + 1
    per_source = np.bincount(runs.owner - first, runs.counts, last - first).astype(np.int64)
    owner = np.repeat(np.arange(last - first, dtype=np.int32), per_source)
    means, whiten = sources.means[first:last], sources.whiten[first:last]
    offsets = [column[points] - np.repeat(mean, per_source) for column, mean in zip(grid.columns, means.T, strict=True)]
    squared = np.zeros(total, np.float32)
    for axis in range(3):
        along = np.repeat(whiten[:, 3 * axis], per_source) * offsets[0]
        along += np.repeat(whiten[:, 3 * axis + 1], per_source) * offsets[1]
        along += np.repeat(whiten[:, 3 * axis + 2], per_source) * offsets[2]
        along *= along
        squared += along
    near = np.flatnonzero(squared <= np.float32(cut_off**2))
    labels = grid.labels[points[near]]
    votes = np.exp(np.float32(-0.5) * squared[near])
    ids = sources.ids[first:last]
    # write the label with most votes for each Gaussian that has any
    sums = np.bincount(owner[near] * grid.num_labels + labels, votes, len(ids) * grid.num_labels)
    sums = sums.reshape(len(ids), grid.num_labels)
    voted = sums.any(1)
    winners[ids[voted]] = sums[voted].argmax(1)
