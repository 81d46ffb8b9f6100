"""Points of the world and the Gaussians that are there."""

import numpy as np

from ..base.arrays import Doubles, Indices, RowIds, Vector3, WholeNumbers
from ..errors import InputError
from ..scene.gaussians import Gaussians
from ..scene.parted import AnyGaussians, middle

MAX_DEVIATIONS = 3.0  # standard ones, of a place from the Gaussian that is meant
MAX_DISTANCE_SHARE = 0.01  # of the scene's size: people and models round their numbers
MIN_VARIANCE_SHARE = 1e-9  # that the thinnest axis of a Gaussian has of the largest
Point = tuple[float, float, float] | Vector3
MAX_CANDIDATES = 64  # by the distance of centres


@np.errstate(over="ignore", invalid="ignore")  # points beyond all that can be squared
def nearest_gaussian(gaussians: AnyGaussians, candidates: WholeNumbers, point: Point) -> int:
    """Return the row of the candidate that covers a point of the world best.

    Of the 64 candidates with the nearest centres, the one of highest density at the point (opacity times
    the Gaussian's fall-off); where all have fallen off, the nearest centre.

    Raises: InputError: a point that is not finite, no candidates, or none near the point.
    """
    at = np.asarray(point, np.float64)
    if at.shape != (3,) or not np.isfinite(at).all():
        raise InputError(f"expected a point of three finite numbers, got {point}")
    if not len(candidates):
        raise InputError("no Gaussian of this scene has a feature")
    ids, squares = _nearest(gaussians, np.asarray(candidates), at)
    near = gaussians.shapes_of(ids)
    distance = float(np.sqrt(squares[0]))
    deviations = _deviations(near, at - gaussians.origin)
    if not np.isfinite(distance) or (
        deviations.min() > MAX_DEVIATIONS and distance > MAX_DISTANCE_SHARE * _size(gaussians, candidates)
    ):
        x, y, z = near.positions[0]
        raise InputError(
            f"nothing with a feature is at {point[0]:.8g}, {point[1]:.8g}, {point[2]:.8g}: the nearest Gaussian is "
            f"{distance:.3g} away, at {x:.3f}, {y:.3f}, {z:.3f}"
        )
    density = near.opacities * np.exp(-0.5 * np.minimum(deviations, 30.0) ** 2)
    return int(ids[density.argmax()] if deviations.min() <= MAX_DEVIATIONS else ids[0])


def _nearest(gaussians: AnyGaussians, candidates: RowIds, at: Vector3) -> tuple[Indices, Doubles]:
    """Return the rows of up to MAX_CANDIDATES, the nearest centre first, and the squares of their distances.

    Candidates ascend; of equal distances the first come first. Parts that are further away than all of these are
    not read.
    """
    ids, squares = np.empty(0, np.int64), np.empty(0)
    for first, away2, part in gaussians.parts_near(at):
        if len(ids) == MAX_CANDIDATES and away2 > squares[-1]:
            break
        begin, end = np.searchsorted(candidates, np.array([first, first + len(part)], candidates.dtype))
        own = candidates[begin:end]
        offsets = part.means[own - first].astype(np.float64) - (at - gaussians.origin)
        ids = np.concatenate([ids, own.astype(np.int64)])
        squares = np.concatenate([squares, np.einsum("ni,ni->n", offsets, offsets)])
        if len(squares) > MAX_CANDIDATES:
            (kept,) = np.nonzero(squares <= np.partition(squares, MAX_CANDIDATES - 1)[MAX_CANDIDATES - 1])
            ids, squares = ids[kept], squares[kept]
        order = np.lexsort((ids, squares))[:MAX_CANDIDATES]
        ids, squares = ids[order], squares[order]
    return ids, squares


def _deviations(few: Gaussians, point: np.ndarray) -> np.ndarray:
    """Return the distance of each Gaussian's centre in its own standard deviations."""
    xx, xy, xz, yy, yz, zz = few.covariances().T
    matrices = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
    largest = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    matrices = matrices + MIN_VARIANCE_SHARE * largest * np.eye(3)
    offsets = point - few.means.astype(np.float64)
    solved = np.linalg.solve(matrices, offsets[..., None])[..., 0]
    deviations = np.sqrt(np.maximum((offsets * solved).sum(1), 0))
    return np.nan_to_num(deviations, nan=np.inf, posinf=np.inf)


def _size(gaussians: AnyGaussians, candidates: WholeNumbers) -> float:
    """Return the diagonal of the box of the middle 98 %: stray Gaussians do not count."""
    low, high = middle(gaussians, (0.01, 0.99), candidates)
    return float(np.linalg.norm(high - low))
