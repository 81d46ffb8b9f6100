"""Levels of detail: neighbouring Gaussians merged into fewer ones that look like them from afar.

A group of Gaussians becomes one with the mean, the covariance and the colours of their mixture, each weighted with its
mass, opacity times area. Its opacity is such that the mass stays, as far as an opacity of 1 allows. Pairs are merged
that change a picture least: light ones, near each other for their sizes, of like colours and shapes.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..base.arrays import (
    Array,
    DoubleRows,
    Doubles,
    Float64,
    FloatRows,
    Indices,
    Int,
    Matrices,
    OtherIndices,
    Quats,
    Vectors,
)
from ..errors import InputError
from .gaussians import SH_C0, UPPER, Gaussians

MERGE_NEIGHBOURS = 8  # of each Gaussian that it may be merged with
MAX_MERGED_SHARE = 0.25  # of all rows in a pass: merged rows can merge again, so cheap pairs go first
MIN_OPACITY = 1e-6  # of a weight, so that invisible Gaussians have a mean, too
MIN_SCALE = 1e-20  # standard deviation of a merged Gaussian, scene units, whose cube float32 holds
COLOUR_WEIGHT = 30.0  # of a squared difference of colours, 0 to 1, beside squared distances in standard deviations


@dataclass(frozen=True, eq=False)
class Level:
    """A coarser scene. group_of: the row of `gaussians` that each row of the finer scene went into."""

    gaussians: Gaussians
    group_of: Indices


def coarser(gaussians: Gaussians, count: int, within: Int[Array, " n"] | None = None) -> Level:
    """Merge neighbours until at most `count` Gaussians are left, or none that may be merged.

    Rows of the result are in the order of the first row of each group, and further columns are those of its heaviest
    row. The same bits for the same scene.

    Args:
        gaussians: the finer scene.
        count: number of Gaussians, 1 or more.
        within: a number of each row, such as that of its object; only rows of one number are merged.

    Raises: InputError: a count below 1, or `within` of another length.
    """
    if count < 1:
        raise InputError(f"count: expected 1 or more Gaussians, got {count}")
    kinds = np.zeros(len(gaussians), np.int64) if within is None else np.asarray(within)
    if kinds.shape != (len(gaussians),):
        raise InputError(f"within: expected {len(gaussians):,} numbers, got an array {kinds.shape}")
    group_of = np.arange(len(gaussians))
    while len(gaussians) > count:
        most = min(len(gaussians) - count, max(1, int(MAX_MERGED_SHARE * len(gaussians))))
        # The group of each row: up to `most` pairs, and the others alone
        first, second = _edges(gaussians.means)
        alike = kinds[first] == kinds[second]
        first, second = first[alike], second[alike]
        order = np.argsort(costs(gaussians, first, second), kind="stable")
        chosen = _matched(len(gaussians), first[order], second[order])[:most]
        leader = np.arange(len(gaussians))
        leader[second[order][chosen]] = first[order][chosen]
        numbers = np.cumsum(leader == np.arange(len(leader))) - 1
        step = numbers[leader]
        if step.max() + 1 == len(gaussians):
            break
        kinds = kinds[np.unique(step, return_index=True)[1]]
        gaussians, group_of = merged(gaussians, step), step[group_of]
    return Level(gaussians, group_of)


def merged(gaussians: Gaussians, group_of: Indices) -> Gaussians:
    """Merge the rows of each group into one Gaussian.

    Args:
        gaussians: the scene.
        group_of: number of each row's group, from 0; every number up to the largest is there.
    """
    masses, areas = masses_of(gaussians), areas_of(gaussians.scales)
    sums = _Sums(group_of, masses)
    means = sums.mean(gaussians.means.astype(np.float64))
    apart = gaussians.means - means[group_of]
    spread = np.stack([apart[:, i] * apart[:, j] for i, j in UPPER], 1)
    quats, scales = shapes_of(sums.mean(gaussians.covariances() + spread))
    shown = np.bincount(group_of, gaussians.opacities * areas)
    alone = sums.sizes == 1
    first = sums.heaviest[alone]  # rows that nothing was merged with stay as they are
    quats[alone], scales[alone] = gaussians.quats[first], gaussians.scales[first]
    opacities = np.minimum(shown / areas_of(scales), 1).astype(np.float32)
    opacities[alone] = gaussians.opacities[first]
    means = means.astype(np.float32)
    means[alone] = gaussians.means[first]
    return replace(
        gaussians,
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        sh=np.stack([sums.mean(c).astype(np.float32) for c in gaussians.sh.swapaxes(0, 1)], 1),
        extra={name: column[sums.heaviest] for name, column in gaussians.extra.items()},
    )


def areas_of(scales: Vectors) -> Doubles:
    """Return the area of each Gaussian as seen from all sides, up to a common factor."""
    a, b, c = scales.T.astype(np.float64)
    return a * b + b * c + c * a


def masses_of(gaussians: Gaussians) -> Doubles:
    """Return how much each Gaussian covers, opacity times area, above 0."""
    return np.maximum(gaussians.opacities, MIN_OPACITY) * areas_of(gaussians.scales)


class _Sums:
    """Weighted means of the rows of each group."""

    def __init__(self, group_of: Indices, masses: Doubles) -> None:
        self._order = np.lexsort((-masses, group_of))
        self.sizes = np.bincount(group_of)
        self._starts = np.concatenate([[0], np.cumsum(self.sizes)[:-1]])
        self.heaviest = self._order[self._starts]
        self._weights = masses[self._order] / np.bincount(group_of, masses)[group_of[self._order]]

    def mean(self, values: DoubleRows | FloatRows) -> Float64[Array, "g k"]:
        return np.add.reduceat(values[self._order] * self._weights[:, None], self._starts, axis=0)


def shapes_of(covariances: Float64[Array, "n 6"]) -> tuple[Quats, Vectors]:
    """Return rotations (w, x, y, z) and standard deviations of covariances, given as upper triangles."""
    matrices = np.empty((len(covariances), 3, 3))
    for at, (i, j) in enumerate(UPPER):
        matrices[:, i, j] = matrices[:, j, i] = covariances[:, at]
    variances, axes = np.linalg.eigh(matrices)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    scales = np.sqrt(np.maximum(variances, MIN_SCALE**2)).astype(np.float32)
    return quaternions_of(axes), scales


def quaternions_of(rotations: Matrices) -> Quats:
    """Return the unit quaternions (w, x, y, z) of rotation matrices, from the largest component of each."""
    m = rotations.transpose(1, 2, 0)
    products = np.array(  # 4 q q^T
        [
            [1 + m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2]],
        ]
    )
    largest = np.einsum("iin->in", products).argmax(0)
    quats = products[largest, :, np.arange(len(rotations))]
    return np.asarray(quats / np.linalg.norm(quats, axis=1, keepdims=True), np.float32)


def _edges(means: Vectors) -> tuple[OtherIndices, OtherIndices]:
    """Return pairs of near rows, the lower one first, each pair once, in order."""
    from scipy.spatial import cKDTree

    near = cKDTree(means).query(means, k=min(MERGE_NEIGHBOURS + 1, len(means)))[1]
    rows = np.repeat(np.arange(len(means)), near.shape[1])
    low, high = np.minimum(rows, near.ravel()), np.maximum(rows, near.ravel())
    keys = np.sort(low[low < high] * np.int64(len(means)) + high[low < high])
    keys = keys[np.diff(keys, prepend=-1) > 0]  # np.unique hashes, which takes as long as finding the neighbours
    return keys // len(means), keys % len(means)


def costs(gaussians: Gaussians, first: Indices, second: Indices) -> Doubles:
    """Return how much a picture changes where two Gaussians are merged: what each is away from the other, by mass."""
    masses = masses_of(gaussians)
    sizes = (gaussians.scales.astype(np.float64) ** 2).mean(1)
    apart = ((gaussians.means[first] - gaussians.means[second]).astype(np.float64) ** 2).sum(1)
    colours = SH_C0 * gaussians.sh[:, 0].astype(np.float64)
    unlike = ((colours[first] - colours[second]) ** 2).sum(1)
    a, b = masses[first], masses[second]
    return a * b / (a + b) * (apart / (sizes[first] + sizes[second]) + COLOUR_WEIGHT * unlike)


def _matched(count: int, first: Indices, second: Indices) -> OtherIndices:
    """Return edges that share no row, taken greedily in their order."""
    alive, chosen = np.arange(len(first)), []
    while len(alive):
        best = np.full(count, len(first))
        np.minimum.at(best, first[alive], alive)
        np.minimum.at(best, second[alive], alive)
        ahead = (best[first[alive]] == alive) & (best[second[alive]] == alive)
        chosen.append(alive[ahead])
        taken = np.zeros(count, bool)
        taken[first[chosen[-1]]] = taken[second[chosen[-1]]] = True
        alive = alive[~(taken[first[alive]] | taken[second[alive]])]
    return np.sort(np.concatenate([*chosen, np.empty(0, np.int64)]).astype(np.int64))
