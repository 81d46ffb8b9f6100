"""Place and size of a scene, and the lengths derived from them.

Positions are kept as float32 relative to a local origin in float64, so that a room in the coordinates of a map is as
exact as one about zero. Poses, boxes and whatever else is reported stay in the scene's own coordinates.
"""

import numpy as np

from ..base.arrays import AnyPoints, Bool, Float, Points, Vector3

PUBLISHED_NEAR = 0.2  # scene units: 3DGS draws nothing nearer to a camera
NEAR_SHARE = 0.05  # of the scene's size, where that is less: in scenes smaller than four units
MAX_DISTANCE_SIZES = 2.0  # from zero: beyond, float32 would round positions more coarsely than about zero
MAX_FLOAT32_DISTANCE_SIZES = 256.0  # beyond, float32 rounds to 1e-5 of the scene's size, and arithmetic on it to more
MIN_SIZED_GAUSSIANS = 16  # fewer say nothing of a scene's size
SOLID_OPACITY = 0.1  # fainter Gaussians may float anywhere
MIDDLE_QUANTILES = (0.05, 0.95)


def size_of(positions: AnyPoints) -> float:
    """Return the diagonal of the box about the middle nine tenths along each axis; 0 for no positions."""
    if not len(positions):
        return 0.0
    low, high = np.quantile(positions, MIDDLE_QUANTILES, axis=0)
    return float(np.linalg.norm(high.astype(np.float64) - low.astype(np.float64)))


def middle_of(positions: AnyPoints) -> Vector3:
    """Return the median along each axis, in float64: the sum of two float32 may overflow float32."""
    return np.asarray(np.median(positions.astype(np.float64), axis=0))


def near_plane(means: AnyPoints, opacities: Float[np.ndarray, " n"] | None = None) -> float:
    """Return the camera z, in scene units, up to which Gaussians are not drawn.

    It is the published 0.2 for a scene four units large or more (the diagonal of the box about the middle nine tenths
    of its centres, of solid Gaussians where opacities are given); a twentieth of its size for a smaller one.
    """
    solid = means if opacities is None else means[opacities >= SOLID_OPACITY]
    positions = solid if len(solid) >= MIN_SIZED_GAUSSIANS else means
    share = NEAR_SHARE * size_of(positions) if len(positions) >= MIN_SIZED_GAUSSIANS else 0.0
    return min(PUBLISHED_NEAR, share) if share > 0 else PUBLISHED_NEAR


def local_origin(positions: AnyPoints) -> Vector3:
    """Return the point that positions are counted from: zero unless the scene is far from zero along some axis.

    Far is more than twice the scene's size; 256 times where float32 holds all positions as they are, since nothing is
    lost by leaving them there. The origin is near the middle along every axis, and a multiple of a power of two of
    about the scene's size. It is zero along an axis on which float32 holds the positions but not what is left of them,
    so that a scene in float32 has the same positions to the bit before and after.
    """
    origin = np.zeros(3)
    size = size_of(positions)
    if not size > 0 or np.abs(positions).max() <= MAX_DISTANCE_SIZES * size:  # then the middle is, too
        return origin
    middle, exact = middle_of(positions), positions.astype(np.float64)
    exact_axes = _fits_float32(exact)
    if np.abs(middle).max() <= (MAX_FLOAT32_DISTANCE_SIZES if exact_axes.all() else MAX_DISTANCE_SIZES) * size:
        return origin
    step = 2.0 ** np.floor(np.log2(size))
    steps = np.round(middle / step)
    loses = exact_axes & ~_fits_float32(exact - steps * step)
    return np.where(loses | (steps == 0), 0.0, steps * step)


def _fits_float32(positions: Points) -> Bool[np.ndarray, " 3"]:
    """Return for each axis whether float32 holds all coordinates exactly."""
    with np.errstate(over="ignore"):
        return (positions.astype(np.float32) == positions).all(0)


def rounding(coordinates: Float[np.ndarray, "..."]) -> float:
    """Return the error, in scene units, that float32 may have at the largest of some coordinates."""
    return float(np.spacing(np.float32(np.abs(coordinates).max(initial=0.0))) / 2)
