"""The slow twin of `kernels.boxes`: one set at a time."""

import numpy as np
from scipy.special import ndtr

from drsplat.base.arrays import Float64, Matrix3, OtherDoubles, OtherFlags, OtherPoints, RowIds, Vector3
from drsplat.kernels.boxes import MAX_STRAY_SHARE, MIN_TAIL_SPARSENESS, OUTLIER_SHARE
from drsplat.scene.boxes import Box
from drsplat.scene.gaussians import Gaussians

DEVIATIONS = 6.0  # beyond which a Gaussian has no mass
STEPS = 30  # of bisection: to a billionth of the range
ROUNDS = 2  # of leaving strays out
FEWEST = 4  # points: fewer have no axes in space
TAILS = np.append(0, MAX_STRAY_SHARE * 0.77 ** np.arange(11, -1, -1))  # shares of the mass that a tail may have


def box_of(gaussians: Gaussians, ids: RowIds, up: Vector3 | None = None) -> Box:
    part = gaussians.subset(ids)
    mass = part.opacities.astype(np.float64)
    mass = mass if mass.sum() > 0 else np.ones(len(part))
    points, covariances = part.means.astype(np.float64), part.covariances()
    inside = without_strays(points, mass / mass.sum(), up)
    points, covariances, mass = points[inside], covariances[inside], mass[inside] / mass[inside].sum()
    axes = _axes(points, mass, up)
    along, spread = np.einsum("mi,ai->ma", points, axes), np.sqrt(_variances(covariances, axes))
    low, high = (mixture_quantile(along, spread, mass, share) for share in (OUTLIER_SHARE, 1 - OUTLIER_SHARE))
    axes, low, high = _ordered(axes, low, high, 2 if up is not None else 3)
    return Box((low + high) / 2 @ axes + gaussians.origin, axes, high - low)


def without_strays(points: OtherPoints, mass: OtherDoubles, up: Vector3 | None) -> OtherFlags:
    """Return which points are in the core along each axis. mass: sums to 1.

    Axes of everything may be turned by strays, so that a second round has better ones.
    """
    inside = np.ones(len(points), bool)
    for _ in range(ROUNDS):
        along = np.einsum("mi,ai->ma", points, _axes(points[inside], mass[inside], up))
        low, high = np.array([core(column, mass) for column in along.T]).T
        inside = ((along >= low) & (along <= high)).all(axis=1)
        if np.count_nonzero(mass[inside] > 0) < FEWEST:
            inside[:] = True
    return inside


def core(values: OtherDoubles, mass: OtherDoubles) -> tuple[float, float]:
    """Return the interval between two tails that has the largest mass^SPARSE / length. mass: sums to 1."""
    lows, highs = _tail(values, mass), -_tail(-values, mass)
    length = highs - lows[:, None]
    least = 1e-9 * length[0, 0] + np.finfo(np.float64).tiny
    kept = MIN_TAIL_SPARSENESS * np.log(1 - TAILS - TAILS[:, None]) - np.log(np.maximum(length, least))
    low, high = np.unravel_index(np.where(length >= 0, kept, -np.inf).argmax(), kept.shape)
    return float(lows[low]), float(highs[high])


def _tail(values: OtherDoubles, mass: OtherDoubles) -> Float64[np.ndarray, " t"]:
    """Return, for each share of TAILS, the first value with more of the mass up to it, itself included."""
    order = np.argsort(values, kind="stable")
    first = np.searchsorted(np.cumsum(mass[order]), TAILS, side="right")
    return np.asarray(values[order[np.minimum(first, len(order) - 1)]])


def mixture_quantile(
    means: Float64[np.ndarray, "m k"], deviations: Float64[np.ndarray, "m k"], mass: OtherDoubles, share: float
) -> Float64[np.ndarray, " k"]:
    """Per column, below which value `share` of a mixture of normal distributions lies. mass: sums to 1."""
    if share > 0.5:
        return -_low_quantile(-means, deviations, mass, 1 - share)
    return _low_quantile(means, deviations, mass, share)


def _low_quantile(
    means: Float64[np.ndarray, "m k"], deviations: Float64[np.ndarray, "m k"], mass: OtherDoubles, share: float
) -> Float64[np.ndarray, " k"]:
    """By bisection, among those alone that reach so low: half of each lies below its mean, which bounds the answer.

    Sums are of one order, which those of BLAS need not be at any number of threads.
    """
    order = np.argsort(means, axis=0, kind="stable")
    before = (np.cumsum(mass[order], axis=0) < 2 * share).sum(axis=0)
    last = np.take_along_axis(order, np.minimum(before, len(order) - 1)[None], axis=0)
    high = np.take_along_axis(means, last, axis=0)[0]
    low_ends = means - DEVIATIONS * deviations
    low, near = low_ends.min(axis=0), (low_ends <= high).any(axis=1)
    means, deviations, mass = means[near], deviations[near], mass[near]
    width = np.maximum(deviations, 1e-12 * (high - low) + np.finfo(np.float64).tiny)
    for _ in range(STEPS):
        middle = (low + high) / 2
        below = np.einsum("m,mk->k", mass, ndtr((middle - means) / width)) < share
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray((low + high) / 2)


def _variances(covariances: Float64[np.ndarray, "m 6"], axes: Matrix3) -> OtherPoints:
    """Of each Gaussian along each axis."""
    a, b = np.triu_indices(3)
    twice = np.where(a == b, 1.0, 2.0)
    return np.asarray(np.maximum(np.einsum("mc,ac->ma", covariances, twice * axes[:, a] * axes[:, b]), 0))


def _axes(points: OtherPoints, mass: OtherDoubles, up: Vector3 | None) -> Matrix3:
    """The principal axes, or those in the plane, and up."""
    if up is None:
        return _principal(points, mass)
    east = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    east = east / np.linalg.norm(east)
    plane = np.stack([east, np.cross(up, east)])
    return np.concatenate([_principal(np.einsum("mi,pi->mp", points, plane), mass) @ plane, up[None]])


def _principal(points: Float64[np.ndarray, "m k"], mass: OtherDoubles) -> Float64[np.ndarray, "k k"]:
    offsets = points - np.einsum("m,mk->k", mass, points) / mass.sum()
    spread = np.einsum("m,mi,mj->ij", mass, offsets, offsets)
    return np.asarray(np.linalg.eigh(spread)[1].T[::-1])


def _ordered(axes: Matrix3, low: Vector3, high: Vector3, free: int) -> tuple[Matrix3, Vector3, Vector3]:
    """The first `free` axes by length, each towards where its largest part is positive; right-handed."""
    order = [*np.argsort(-(high - low)[:free], kind="stable").tolist(), *range(free, 3)]
    axes, low, high = axes[order], low[order], high[order]
    sign = np.sign(axes[np.arange(3), np.abs(axes).argmax(1)])
    sign[free:] = 1
    turned = sign[:, None] * axes
    flip = 1 if free < 3 else 2
    if np.linalg.det(turned) < 0:
        sign[flip] = -sign[flip]
        turned = sign[:, None] * axes
    ends = np.stack([low * sign, high * sign])
    return turned, ends.min(axis=0), ends.max(axis=0)
