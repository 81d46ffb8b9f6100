"""The float64 twins of the photometric loss and of the optimiser's step.

Source: Kerbl et al. 2023 (3D Gaussian Splatting) Eq. 7, "(1 - w) L1 + w (1 - SSIM)"; Wang et al. 2004 for
SSIM; Kingma and Ba 2015, Algorithm 1, for Adam.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import correlate1d

from drsplat.base.arrays import Float, Float64

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
STEP = 1e-5


class Loss(NamedTuple):
    """value = (1 - w) l1 + w (1 - ssim); gradient: of value by the image."""

    value: float
    l1: float
    ssim: float
    gradient: Float64[np.ndarray, "h w 3"]


def ssim_map(image: Float64[np.ndarray, "h w 3"], target: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "h w 3"]:
    """Structural similarity at each pixel and channel; what is outside the image counts as zero."""
    mean_x, mean_y = _blurred(image), _blurred(target)
    var_x = _blurred(image * image) - mean_x * mean_x
    var_y = _blurred(target * target) - mean_y * mean_y
    both = _blurred(image * target) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return np.asarray(luminance * (2 * both + C2) / (var_x + var_y + C2))


def photometric_loss(
    image: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w 3"], ssim_weight: float = 0.2
) -> Loss:
    """L1 and SSIM, means over pixels and channels; the gradient of SSIM by central differences."""
    x, y = image.astype(np.float64), target.astype(np.float64)
    l1, ssim = float(np.abs(x - y).mean()), float(ssim_map(x, y).mean())
    gradient = (1 - ssim_weight) * np.sign(x - y) / x.size
    gradient -= ssim_weight * _ssim_slopes(x, y)
    return Loss((1 - ssim_weight) * l1 + ssim_weight * (1 - ssim), l1, ssim, gradient)


def adam_step(
    parameter: Float64[np.ndarray, "..."],
    gradient: Float[np.ndarray, "..."],
    first_moment: Float64[np.ndarray, "..."],
    second_moment: Float64[np.ndarray, "..."],
    rate: float,
    step: int,
    *,
    beta1: float = 0.9,
    beta2: float = 0.999,
    epsilon: float = 1e-15,
) -> None:
    """One step in place; the first step is 1."""
    first_moment += (1 - beta1) * (gradient - first_moment)
    second_moment += (1 - beta2) * (gradient.astype(np.float64) ** 2 - second_moment)
    spread = np.sqrt(second_moment / (1 - beta2**step)) + epsilon
    parameter -= rate * first_moment / (1 - beta1**step) / spread


def _ssim_slopes(x: Float64[np.ndarray, "h w 3"], y: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "h w 3"]:
    """A pixel moves the similarity of its own channel within reach of the window only."""
    slopes, reach = np.empty_like(x), WINDOW - 1  # half a window to blur, half to see it
    for row, column in np.ndindex(x.shape[:2]):
        top, left = max(row - reach, 0), max(column - reach, 0)
        near = np.s_[top : row + reach + 1, left : column + reach + 1]
        moved = x[near].copy()
        sums = np.empty((2, 3))
        for side, step in enumerate((STEP, -STEP)):
            moved[row - top, column - left] = x[row, column] + step
            sums[side] = ssim_map(moved, y[near]).sum(axis=(0, 1))
        slopes[row, column] = (sums[0] - sums[1]) / (2 * STEP)
    return slopes / x.size


def _blurred(values: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "h w 3"]:
    offsets = np.arange(WINDOW) - WINDOW // 2
    window = np.exp(-0.5 * (offsets / SIGMA) ** 2)
    window /= window.sum()
    rows = correlate1d(values, window, axis=0, mode="constant")
    return np.asarray(correlate1d(rows, window, axis=1, mode="constant"))
