"""Image tower: 3x3 convolutions with ReLU, pooling by mean and maximum, a projection."""

from collections.abc import Mapping

import numpy as np

from ....base.arrays import Float32
from ....kernels.algebra import convolve, dense_rows

INPUT_SIDE_PIXELS = 64
STRIDES = (2, 2, 1, 2, 1, 2, 1)
"""Strides of the convolutions conv0, conv1 ..., each with one pixel of zeros around its input."""

Tensors = Mapping[str, np.ndarray]


def embed_images(
    pixels: Float32[np.ndarray, "n h w 3"], weights: Tensors, *, threads: int = 0
) -> Float32[np.ndarray, "n d"]:
    """Return unit vectors, the same bits at any `threads`. pixels: from -1 to 1, squares of INPUT_SIDE_PIXELS.

    weights: conv<i>.weight (9 * inputs, outputs), rows in the order of row, column, channel; conv<i>.bias;
    projection (2 * channels, D), of the mean and the largest of each channel.
    """
    x = pixels
    for layer, stride in enumerate(STRIDES):
        x = convolve(x, weights[f"conv{layer}.weight"], weights[f"conv{layer}.bias"], stride, threads=threads)
    pooled = np.concatenate([x.mean((1, 2)), x.max((1, 2))], axis=1)
    out = dense_rows(pooled, weights["projection"], threads=threads)
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))
