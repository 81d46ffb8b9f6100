"""Where a scene lies, how large it is, and the lengths that follow from it.

Positions are kept as float32 relative to a local origin in float64, so that a room in the coordinates of a map is as
exact as one about zero. Poses, boxes and whatever else is reported stay in the scene's own coordinates.
"""

import numpy as np
from jaxtyping import Float, Float32, Float64

PUBLISHED_NEAR = 0.2  # scene units: 3DGS draws nothing that is nearer to a camera
NEAR_SHARE = 0.05  # of the scene's size, where that is less: scenes smaller than four units
FAR = 256.0  # sizes from zero: beyond, float32 rounds positions to more than 1e-5 of the scene's size
FEWEST = 16  # fewer Gaussians than this say nothing of a scene's size
SOLID = 0.1  # opacity; fainter Gaussians may float anywhere
MIDDLE = (0.05, 0.95)


def size_of(positions: Float[np.ndarray, "n 3"]) -> float:
    """Diagonal of the box about the middle nine tenths along each axis; 0 of nothing."""
    if not len(positions):
        return 0.0
    low, high = np.quantile(positions, MIDDLE, axis=0)
    return float(np.linalg.norm(high.astype(np.float64) - low.astype(np.float64)))


def middle_of(positions: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " 3"]:
    """The median along each axis, in float64: the sum of two float32 may be beyond float32."""
    return np.asarray(np.median(positions.astype(np.float64), axis=0))


def near_plane(means: Float[np.ndarray, "n 3"], opacities: Float[np.ndarray, " n"] | None = None) -> float:
    """Camera z, in scene units, up to which Gaussians are not drawn.

    The published 0.2 where the scene is four units large or more (the diagonal of the box about the middle nine
    tenths of its centres, of solid Gaussians where opacities are given); a twentieth of its size where it is smaller.
    """
    solid = means if opacities is None else means[opacities >= SOLID]
    positions = solid if len(solid) >= FEWEST else means
    share = NEAR_SHARE * size_of(positions) if len(positions) >= FEWEST else 0.0
    return min(PUBLISHED_NEAR, share) if share > 0 else PUBLISHED_NEAR


def local_origin(positions: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " 3"]:
    """What to count positions from: zero along every axis on which the scene is not far from zero.

    Far is more than 256 times the scene's size. The origin is a multiple of a power of two of about that size, so
    that positions in float32 lose nothing by being counted from it.
    """
    origin = np.zeros(3)
    size = size_of(positions)
    if not size > 0 or np.abs(positions).max() <= FAR * size:  # so is the middle then
        return origin
    middle = middle_of(positions)
    far = np.abs(middle) > FAR * size
    step = 2.0 ** np.floor(np.log2(size))
    origin[far] = np.round(middle[far] / step) * step
    return origin


def rounding(positions: Float32[np.ndarray, "n 3"]) -> float:
    """Scene units by which the largest coordinates of the middle of a scene may be off in float32."""
    largest = np.abs(middle_of(positions)).max(initial=0.0)
    return float(np.spacing(np.float32(largest)) / 2)
