"""Convolutions of small networks on NumPy and the native product of matrices."""

import numpy as np

from ..arrays import Float32
from ..kernels.algebra import dense_rows


def convolve(
    x: Float32[np.ndarray, "n h w c"],
    weight: Float32[np.ndarray, "k o"],
    bias: Float32[np.ndarray, " o"],
    stride: int = 1,
    *,
    threads: int = 0,
) -> Float32[np.ndarray, "n _ _ o"]:
    """Return a 3x3 convolution and ReLU, with one pixel of zeros around the input; the same bits at any `threads`.

    weight: (9 * inputs, outputs), rows in the order of row, column, channel.
    """
    padded = np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))
    windows = windows[:, ::stride, ::stride].transpose(0, 1, 2, 4, 5, 3)
    rows = dense_rows(windows.reshape(-1, weight.shape[0]), weight, threads=threads) + bias
    out: np.ndarray = np.maximum(rows, 0).reshape(*windows.shape[:3], -1)
    return out
