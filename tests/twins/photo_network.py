"""The twin of `kernels.photo_regions.look`: windows of pixels times weights, in float64."""

import numpy as np

from drsplat.base.arrays import Float64, Pixels
from drsplat.kernels.photo_regions import BORDER_STEPS, MAX_TRAIT, TRAIT_STEPS, Layers, Sight


def look(image: Pixels, layers: Layers) -> Sight:
    """As the native one."""
    height, width = image.shape[:2]
    pairs = [(layers[i].astype(np.float64), layers[i + 1].astype(np.float64)) for i in range(0, len(layers), 2)]
    step = 2 ** (len(pairs) // 4)
    pixels = np.pad(image, ((0, -height % step), (0, -width % step), (0, 0)), mode="edge") / 127.5 - 1
    weight, bias = pairs[-1]
    out = _together(_all_levels(_apart(pixels), pairs[:-1]) @ weight + bias)[:height, :width]
    likely = 1 / (1 + np.exp(-out[..., 0]))
    traits = np.clip(np.rint(out[..., 1:] * TRAIT_STEPS), -MAX_TRAIT, MAX_TRAIT)
    return Sight(np.rint(likely * BORDER_STEPS).astype(np.int32), traits.astype(np.int32))


def _all_levels(x: Float64[np.ndarray, "h w c"], pairs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    layer = iter(pairs)
    x, seen = _convolved(x, *next(layer)), []
    for level in range((len(pairs) + 1) // 4):
        x = _pooled(x) if level else x
        x = _convolved(_convolved(x, *next(layer)), *next(layer))
        seen.append(x)
    for beside in reversed(seen[:-1]):
        both = np.concatenate([beside, x.repeat(2, 0).repeat(2, 1)], axis=2)
        x = _convolved(_convolved(both, *next(layer)), *next(layer))
    return x


def _convolved(
    x: Float64[np.ndarray, "h w c"], weight: Float64[np.ndarray, "k o"], bias: Float64[np.ndarray, " o"]
) -> Float64[np.ndarray, "h w o"]:
    """A 3x3 convolution and ReLU, with one pixel of zeros around the input."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(x, ((1, 1), (1, 1), (0, 0))), (3, 3), axis=(0, 1))
    rows = windows.transpose(0, 1, 3, 4, 2).reshape(*x.shape[:2], -1)
    return np.asarray(np.maximum(rows @ weight + bias, 0))


def _pooled(x: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "h2 w2 c"]:
    height, width, count = x.shape
    return np.asarray(x.reshape(height // 2, 2, width // 2, 2, count).max((1, 3)))


def _apart(x: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "h2 w2 d"]:
    """The four pixels of each 2x2 block as channels."""
    height, width, count = x.shape
    blocks = x.reshape(height // 2, 2, width // 2, 2, count).transpose(0, 2, 4, 1, 3)
    return blocks.reshape(height // 2, width // 2, 4 * count)


def _together(x: Float64[np.ndarray, "h w d"]) -> Float64[np.ndarray, "h2 w2 c"]:
    """Undoes `_apart`."""
    height, width, count = x.shape
    blocks = x.reshape(height, width, count // 4, 2, 2).transpose(0, 3, 1, 4, 2)
    return blocks.reshape(2 * height, 2 * width, count // 4)
