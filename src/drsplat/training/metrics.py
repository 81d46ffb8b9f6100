"""How near a rendering is to a photo: PSNR and SSIM over the pixels that the photo covers."""

import math

import numpy as np
from jaxtyping import Float32, Float64, Integer

from ..reference.loss import ssim_map

Image = Float32[np.ndarray, "h w 3"]
Flat = Integer[np.ndarray, " m"]


def psnr(image: Image, photo: Image, outside: Flat | None = None) -> float:
    """Peak signal-to-noise ratio in dB, peak 1; infinite for equal pictures.

    outside: flat indices of pixels that do not count.
    """
    error = (image.astype(np.float64) - photo) ** 2
    mean = float(_inside(error.mean(axis=2), outside).mean())
    return math.inf if mean == 0 else -10 * math.log10(mean)


def ssim(image: Image, photo: Image, outside: Flat | None = None) -> float:
    """Mean structural similarity, channel by channel, with a Gaussian window of 11 and zero padding.

    Source: Wang et al., "Image quality assessment" (2004); window and padding as 3DGS measures.
    """
    similarity = ssim_map(image.astype(np.float64), photo.astype(np.float64))
    return float(_inside(similarity.mean(axis=2), outside).mean())


def _inside(values: Float64[np.ndarray, "h w"], outside: Flat | None) -> Float64[np.ndarray, " k"]:
    flat = values.ravel()
    if outside is None or len(outside) == 0:
        return flat
    return np.delete(flat, outside)
