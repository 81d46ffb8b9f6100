"""Noise out of rendered light: averages over neighbours of the same surface.

The light is divided by the surface's colour first, so that textures stay sharp.
Source: the cross-bilateral filter of Eisemann and Durand (2004), on the features of Rousselle et al. (2013).
"""

import numpy as np
from jaxtyping import Float32, Float64
from scipy.ndimage import median_filter

from drsplat.base.arrays import PixelNumbers

Image = Float64[np.ndarray, "h w 3"]
RADIUS = 3  # pixels
_SPREAD = 2 * (RADIUS / 1.5) ** 2
_HALF = [(y, x) for y in range(RADIUS + 1) for x in range(-RADIUS, RADIUS + 1) if (y, x) > (0, 0)]
_COLOR, _NORMAL, _LIGHT = 0.15, 0.25, 0.6  # what counts as another surface; light as a log ratio


def denoised(light: Image, albedo: Image, normals: Image) -> Image:
    """light: linear radiance. albedo, normals: of the surface that each pixel sees."""
    light, albedo, normals = (np.asarray(x, np.float32) for x in (light, albedo, normals))
    base = np.clip(albedo, 0.03, None)
    falling = _without_fireflies(light / base)
    level = np.log(0.02 + _blurred(falling.mean(2))) / _LIGHT
    features = np.concatenate([albedo / _COLOR, normals / _NORMAL, level[..., None]], axis=2)
    total, weight = falling.copy(), np.ones(falling.shape[:2], np.float32)
    for dy, dx in _HALF:
        a, b = _overlap(dy, dx, *falling.shape[:2])
        difference = features[b] - features[a]
        w = np.exp(-(dy**2 + dx**2) / _SPREAD - np.einsum("hwc,hwc->hw", difference, difference))
        total[a] += w[..., None] * falling[b]
        total[b] += w[..., None] * falling[a]
        weight[a] += w
        weight[b] += w
    return np.asarray(total / weight[..., None] * base, np.float64)


def _without_fireflies(falling: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """No pixel much brighter than the middling one of its neighbours."""
    level = falling.mean(2)
    most = 2.5 * median_filter(level, 3) + 0.05
    return falling * np.minimum(1, most / np.maximum(level, 1e-6))[..., None]


def _overlap(dy: int, dx: int, height: int, width: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Pixels with a neighbour at (dy, dx), and those neighbours."""
    rows, columns = _span(dy, height), _span(dx, width)
    return (rows[0], columns[0]), (rows[1], columns[1])


def _span(shift: int, length: int) -> tuple[slice, slice]:
    return (slice(max(0, -shift), length - max(0, shift)), slice(max(0, shift), length - max(0, -shift)))


def _blurred(image: PixelNumbers) -> PixelNumbers:
    """A 3x3 mean, to judge the level of light by."""
    padded = np.pad(image, 1, mode="edge")
    h, w = image.shape
    return sum(padded[y : y + h, x : x + w] for y in range(3) for x in range(3)) / 9
