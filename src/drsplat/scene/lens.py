"""Pixels of the undistorted pinhole to pixels of the photo, and back.

Coefficients act on normalised coordinates (x/z, y/z), so they are the same for every raster size.
Source: the OpenCV camera model with k1, k2, p1, p2; COLMAP's SIMPLE_RADIAL, RADIAL and OPENCV are special cases of it.
"""

import math

import numpy as np

from ..base.arrays import Float64
from ..errors import InputError
from .views import View

Points = Float64[np.ndarray, "*n xy"]
Coefficients = tuple[float, float, float, float]


def distort_points(view: View, pixels: Points) -> Points:
    """Map pixels of the pinhole `view` to pixels of its photo at the same size.

    The result is NaN where the radial polynomial has folded over: no light path of a real lens leads there.

    Raises: InputError: pixels are not (..., 2).
    """
    if view.distortion is None:
        return _checked(pixels).copy()
    normalised = _normalised(view, _checked(pixels))
    distorted = _distort(normalised, view.distortion)
    distorted[(normalised**2).sum(-1) >= fold_radius2(view.distortion)] = np.nan
    return _pixels(view, distorted)


def undistort_points(view: View, pixels: Points) -> Points:
    """Map pixels of the photo to pixels of the pinhole `view`, by Newton's method.

    The result is NaN where no point of the pinhole maps to the pixel.

    Raises: InputError: pixels are not (..., 2).
    """
    if view.distortion is None:
        return _checked(pixels).copy()
    target = _normalised(view, _checked(pixels))
    estimate = target.copy()
    limit2 = fold_radius2(view.distortion)
    for _ in range(20):
        estimate -= _newton_step(estimate, target, view.distortion)
    missed = np.abs(_distort(estimate, view.distortion) - target).max(-1) > 1e-9
    estimate[missed | ((estimate**2).sum(-1) >= limit2)] = np.nan
    return _pixels(view, estimate)


def fold_radius2(coefficients: Coefficients) -> float:
    """Return the squared radius at which r (1 + k1 r^2 + k2 r^4) stops growing; inf if it never does."""
    a, b = 5 * coefficients[1], 3 * coefficients[0]  # a s^2 + b s + 1 = 0, s = r^2
    discriminant = b * b - 4 * a
    if discriminant < 0:
        return math.inf
    q = -(b + math.copysign(math.sqrt(discriminant), b)) / 2  # without cancellation
    roots = [1 / q if q else 0.0, q / a if a else 0.0]
    return min((root for root in roots if root > 0), default=math.inf)


def _distort(points: Points, coefficients: Coefficients) -> Points:
    k1, k2, p1, p2 = coefficients
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + k2 * r2)
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1
    )


def _newton_step(points: Points, target: Points, coefficients: Coefficients) -> Points:
    """Return inverse(Jacobian) @ (distort(points) - target), each component clipped to [-1, 1]."""
    k1, k2, p1, p2 = coefficients
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial, slope = 1 + r2 * (k1 + k2 * r2), k1 + 2 * k2 * r2
    a = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    b = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    d = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    error = _distort(points, coefficients) - target
    determinant = a * d - b * b
    determinant = np.where(np.abs(determinant) < 1e-9, 1e-9, determinant)
    step = np.stack([d * error[..., 0] - b * error[..., 1], a * error[..., 1] - b * error[..., 0]], -1)
    return np.clip(step / determinant[..., None], -1, 1)


def _normalised(view: View, pixels: Points) -> Points:
    return (pixels - view.K[:2, 2]) @ np.linalg.inv(view.K[:2, :2]).T


def _pixels(view: View, points: Points) -> Points:
    return points @ view.K[:2, :2].T + view.K[:2, 2]


def _checked(pixels: Points) -> Points:
    if pixels.ndim < 1 or pixels.shape[-1] != 2:
        raise InputError(f"pixels: expected (..., 2), got {pixels.shape}")
    return pixels
