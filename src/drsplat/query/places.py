"""Points of the world and the Gaussians that are there."""

import numpy as np

from ..base.arrays import Float64, Integer
from ..errors import InputError
from ..scene.gaussians import Gaussians

FAR = 3.0  # standard deviations
SLACK = 0.01  # of the scene's size: people and models round their numbers
FLAT = 1e-9  # of a Gaussian's variance: what its thinnest axis has at least
Point = tuple[float, float, float] | Float64[np.ndarray, " 3"]
NEAREST = 64  # candidates by the distance of centres


@np.errstate(over="ignore", invalid="ignore")  # points beyond all that can be squared
def nearest_gaussian(gaussians: Gaussians, candidates: Integer[np.ndarray, " r"], point: Point) -> int:
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
    at = at - gaussians.origin
    means = gaussians.means[candidates].astype(np.float64)
    squares = np.einsum("ni,ni->n", means - at, means - at)
    near = np.argpartition(squares, min(NEAREST, len(squares)) - 1)[:NEAREST]
    near = near[np.argsort(squares[near], kind="stable")]
    distance = float(np.sqrt(squares[near[0]]))
    ids = np.asarray(candidates)[near].astype(np.int64)
    deviations = _deviations(gaussians, ids, at)
    if not np.isfinite(distance) or (deviations.min() > FAR and distance > SLACK * _size(means)):
        x, y, z = means[near[0]] + gaussians.origin
        raise InputError(
            f"nothing with a feature is at {point[0]:.8g}, {point[1]:.8g}, {point[2]:.8g}: the nearest Gaussian is "
            f"{distance:.3g} away, at {x:.3f}, {y:.3f}, {z:.3f}"
        )
    density = gaussians.opacities[ids] * np.exp(-0.5 * np.minimum(deviations, 30.0) ** 2)
    return int(ids[density.argmax()] if deviations.min() <= FAR else ids[0])


def _deviations(gaussians: Gaussians, ids: Integer[np.ndarray, " m"], point: np.ndarray) -> np.ndarray:
    """Return the distance of each Gaussian's centre in its own standard deviations."""
    few = gaussians.subset(ids)
    xx, xy, xz, yy, yz, zz = few.covariances().T
    matrices = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
    largest = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    matrices = matrices + FLAT * largest * np.eye(3)
    offsets = point - few.means.astype(np.float64)
    solved = np.linalg.solve(matrices, offsets[..., None])[..., 0]
    deviations = np.sqrt(np.maximum((offsets * solved).sum(1), 0))
    known: np.ndarray = np.nan_to_num(deviations, nan=np.inf, posinf=np.inf)
    return known


def _size(means: np.ndarray) -> float:
    """Return the diagonal of the box of the middle 98 %: stray Gaussians do not count."""
    low, high = np.quantile(means, (0.01, 0.99), axis=0)
    return float(np.linalg.norm(high - low))
