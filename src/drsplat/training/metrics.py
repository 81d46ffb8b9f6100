"""How near a rendering is to a photo: PSNR and SSIM over the pixels that the photo covers."""

import math

import numpy as np
from scipy.ndimage import gaussian_filter

from ..base.arrays import Doubles, Float64, Image, Mask

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2


def psnr(image: Image, photo: Image, outside: Mask | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB, peak 1; infinite for equal pictures.

    outside: True where a pixel does not count.
    """
    error = (image.astype(np.float64) - photo) ** 2
    mean = float(_inside(error.mean(2), outside).mean())
    return math.inf if mean == 0 else -10 * math.log10(mean)


def ssim(image: Image, photo: Image, outside: Mask | None = None) -> float:
    """Return the mean structural similarity, channel by channel, with a Gaussian window of 11 and zero padding.

    Source: Wang et al., "Image quality assessment" (2004); window and padding as 3DGS measures.
    """
    a, b = image.astype(np.float64), photo.astype(np.float64)
    x, y, xx, yy, xy = map(_blurred, (a, b, a * a, b * b, a * b))
    luminance = (2 * x * y + C1) / (x * x + y * y + C1)
    structure = (2 * (xy - x * y) + C2) / (xx - x * x + yy - y * y + C2)
    return float(_inside((luminance * structure).mean(2), outside).mean())


def _blurred(values: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "h w 3"]:
    return gaussian_filter(values, (SIGMA, SIGMA, 0), mode="constant", radius=WINDOW // 2)


def _inside(values: Float64[np.ndarray, "h w"], outside: Mask | None) -> Doubles:
    return values.ravel() if outside is None else values[~outside]
