"""Gaussians to image-plane ellipses in float64, with bounds on what float32 arithmetic would lose.

Source: Kerbl et al. 2023 (3D Gaussian Splatting) Eq. 5 and its rasterizer's tile rectangles;
Zwicker et al. 2001 for the affine approximation.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from drsplat.base.arrays import Doubles, Float, Float64, Int, Matrices, PlanePoints, Points, Vector3
from drsplat.scene.views import View

TILE = 16
FRUSTUM_MARGIN = 1.3
BLUR = 0.3
MIN_ALPHA = 1 / 255

ROUNDING = 4 * 2.0**-24  # four float32 roundings: about what a short sum of products loses


@runtime_checkable
class Splats(Protocol):
    """Structure of arrays: what `drsplat.kernels.splat_arrays` gives, in any float type.

    means: relative to origin, which is a world position. covariances: rows xx, xy, xz, yy, yz, zz. opacities: in
    [0, 1]. near: camera z up to which nothing is drawn. antialiased: opacities are dimmed as splats are widened.
    """

    @property
    def means(self) -> Float[np.ndarray, "3 n"]: ...
    @property
    def covariances(self) -> Float[np.ndarray, "6 n"]: ...
    @property
    def opacities(self) -> Float[np.ndarray, " n"]: ...
    @property
    def near(self) -> float: ...
    @property
    def origin(self) -> Vector3: ...
    @property
    def antialiased(self) -> bool: ...


class Projection(NamedTuple):
    """Gaussians in front of the camera as image-plane ellipses, front to back, ties by content.

    opacities: at the centre, dimmed if antialiased. centers: pixels. depths: camera z. conics: inverse covariances
    (xx, xy, yy) in 1 / pixel^2.
    tiles, certain_tiles, possible_tiles: half-open tile rectangles (x0, y0, x1, y1) of the 3-sigma
    square: in float64, and the least and the most that rounding could make of it.
    *_error: bounds on the float32 error, in the unit of the quantity (of covariances: per entry).
    cancellation: by how much the determinant of the covariance magnifies relative rounding.
    dimming_error: bound on the float32 error of the logarithm of an antialiased opacity.
    """

    ids: Int[np.ndarray, " n"]
    opacities: Doubles
    centers: PlanePoints
    center_error: PlanePoints
    depths: Doubles
    depth_error: Doubles
    conics: Points
    covariance_error: Doubles
    cancellation: Doubles
    dimming_error: Doubles
    tiles: Int[np.ndarray, "n 4"]
    certain_tiles: Int[np.ndarray, "n 4"]
    possible_tiles: Int[np.ndarray, "n 4"]


def project(splats: Splats, view: View) -> Projection:
    """Project every Gaussian that is, or by rounding could be, in front of the near plane."""
    near, view = splats.near, view.relative_to(splats.origin)
    rotation, translation = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3:]
    means = splats.means.astype(np.float64)
    points = (rotation @ means + translation).T
    error = ROUNDING * (np.abs(rotation) @ np.abs(means) + np.abs(translation)).T
    visible = (points[:, 2] > near - error[:, 2]) & (splats.opacities >= MIN_ALPHA)
    order = _front_to_back(splats, points[:, 2])
    ids = order[visible[order]]
    points, error = points[ids], error[ids]
    depths, depth_error = points[:, 2], error[:, 2]

    focal, principal = view.K[[0, 1], [0, 1]], view.K[:2, 2]
    slopes = points[:, :2] / depths[:, None]
    center_error = focal * (error[:, :2] + np.abs(slopes) * error[:, 2:]) / depths[:, None]
    center_error += ROUNDING * (focal * np.abs(slopes) + np.abs(principal))

    jacobian = _jacobian(slopes, depths, view) @ rotation
    solid = _symmetric(splats.covariances[:, ids].T.astype(np.float64))
    sharp = _upper(jacobian @ solid @ jacobian.transpose(0, 2, 1))
    covariances = sharp + BLUR * np.array([1, 0, 1])
    sizes = np.abs(jacobian) @ np.abs(solid) @ np.abs(jacobian).transpose(0, 2, 1)
    covariance_error = np.trace(sizes, axis1=1, axis2=2) + 2 * BLUR
    covariance_error *= ROUNDING + 2 * depth_error / depths

    a, b, c = covariances.T
    determinants = determinants_of(covariances)
    cancellation = (a * c + b * b) / determinants
    opacities, dimming_error = splats.opacities[ids].astype(np.float64), np.zeros(len(ids))
    if splats.antialiased:
        dimmed, dimming_error = dimming(sharp, covariances), _dimming_error(sharp, cancellation, depth_error / depths)
        opacities = opacities * dimmed
    solvable = ROUNDING * cancellation < 0.5  # else float32 may find no positive determinant
    centers = focal * slopes + principal
    radius, radius_error = _three_sigma(covariances, covariance_error)
    margin = center_error.max(axis=1, initial=0.0)
    return Projection(
        ids=ids,
        opacities=opacities,
        centers=centers,
        center_error=center_error,
        depths=depths,
        depth_error=depth_error,
        conics=np.stack([c, -b, a], axis=1) / determinants[:, None],
        covariance_error=covariance_error,
        cancellation=cancellation,
        dimming_error=dimming_error,
        tiles=_tile_rectangles(centers, np.ceil(radius), depths > near),
        certain_tiles=_tile_rectangles(
            centers, np.ceil(radius - radius_error) - margin, solvable & (depths > near + depth_error)
        ),
        possible_tiles=_tile_rectangles(centers, np.ceil(radius + radius_error) + margin, depths > near - depth_error),
    )


def dimming(sharp: Points, widened: Points) -> Doubles:
    """Return the factor sqrt(det sharp / det widened) on opacities: a splat's light stays as its area grows.

    sharp, widened: xx, xy, yy of a splat's covariance before and after BLUR was added.

    Source: Yu et al. 2024 (Mip-Splatting), "2D Mip filter".
    """
    ratio = determinants_of(sharp) / determinants_of(widened)
    return np.asarray(np.sqrt(np.clip(ratio, 0, 1)))


def determinants_of(covariances: Points) -> Doubles:
    a, b, c = covariances.T
    return np.asarray(a * c - b * b)


def _dimming_error(sharp: Points, cancellation: Doubles, depth_error: Doubles) -> Doubles:
    """Half the relative errors of both determinants; without bound where a splat is a line."""
    a, b, c = sharp.T
    with np.errstate(divide="ignore", invalid="ignore"):
        magnified = (a * c + b * b) / np.maximum(determinants_of(sharp), 0)
    relative = ROUNDING + 2 * depth_error
    return np.asarray(0.5 * relative * (np.nan_to_num(magnified, nan=np.inf) + cancellation))


def _front_to_back(splats: Splats, depths: Doubles) -> Int[np.ndarray, " n"]:
    """Return the rows by depth; of one depth by the bits of place, covariance and opacity, then by index.

    Depths as float32, so that what is one depth to the native sort is one depth here.
    """
    content = (*splats.means, *splats.covariances, splats.opacities)
    bits = [np.ascontiguousarray(column, np.float32).view(np.uint32) for column in content]
    return np.lexsort((*reversed(bits), depths.astype(np.float32)))


def _jacobian(slopes: PlanePoints, depths: Doubles, view: View) -> Float64[np.ndarray, "n 2 3"]:
    """Derivative of pixel by camera point, at x/z and y/z clamped to +-1.3 tan(fov / 2).

    The clamp is symmetric about the optical axis as in 3DGS, also where the principal point is off
    centre, and tan(fov / 2) is 0.5 * width / fx.
    """
    focal = view.K[[0, 1], [0, 1]]
    limits = FRUSTUM_MARGIN * 0.5 * np.array([view.width, view.height]) / focal
    jacobian = np.zeros((len(depths), 2, 3))
    jacobian[:, [0, 1], [0, 1]] = focal / depths[:, None]
    jacobian[:, :, 2] = -focal * np.clip(slopes, -limits, limits) / depths[:, None]
    return jacobian


def _three_sigma(covariances: Points, error: Doubles) -> tuple[Doubles, Doubles]:
    """Three standard deviations along the long axis, not yet rounded up, and its error bound.

    The discriminant is floored at 0.1 as in 3DGS. Where it is small (round ellipses) the root
    magnifies the rounding of mid^2 - det.
    """
    a, b, c = covariances.T
    mid = 0.5 * (a + c)
    root = np.sqrt(np.maximum(0.1, mid * mid - (a * c - b * b)))
    radius = 3 * np.sqrt(mid + root)
    variance_error = 2 * error + ROUNDING * mid * mid / root
    return radius, 4.5 * variance_error / radius + ROUNDING * radius


def _tile_rectangles(centers: PlanePoints, reach: Doubles, visible: np.ndarray) -> Int[np.ndarray, "n 4"]:
    """Tiles (x0, y0, x1, y1) of the square of half width `reach`, empty where not visible.

    3DGS counts from pixel centres at integers, hence the half pixel, and rounds up with TILE - 1.
    """
    low = np.floor((centers - 0.5 - reach[:, None]) / TILE)
    high = np.floor((centers - 0.5 + reach[:, None] + TILE - 1) / TILE)
    high = np.where(visible[:, None], high, low)
    rectangles = np.clip(np.concatenate([low, high], axis=1), -1, 2**30)  # far ones fit no integer
    return np.asarray(rectangles, np.int64)


def _symmetric(upper: Float64[np.ndarray, "n 6"]) -> Matrices:
    return upper[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


def _upper(matrices: Float64[np.ndarray, "n 2 2"]) -> Points:
    return matrices[:, [0, 0, 1], [0, 1, 1]]
