"""The twin of `kernels.photo_regions.people`: MobileNetV2 and DeepLabv3's head by shifts and products, in float64."""

from collections.abc import Iterator

import numpy as np

from drsplat.base.arrays import Float64, Pixels
from drsplat.kernels.photo_regions import Layers

BLOCKS, PERSON = 17, 15
HALVED, REACHING = (1, 3, 6), (14, 15, 16)  # blocks of which every second pixel is kept, and those with wide windows

Pairs = Iterator[tuple[np.ndarray, np.ndarray]]


def people(image: Pixels, layers: Layers) -> Float64[np.ndarray, "h w"]:
    """As the native one."""
    pairs = iter([(layers[i].astype(np.float64), layers[i + 1].astype(np.float64)) for i in range(0, len(layers), 2)])
    weight, bias = next(pairs)
    windows = np.concatenate(_windows((image - 128.0) / 128, 1), axis=2)
    x = np.clip(windows @ weight + bias, 0, 6)[::2, ::2]
    for block in range(BLOCKS):
        x = _block(x, block, pairs)
    weight, bias = next(pairs)
    own = np.maximum(x @ weight + bias, 0)
    weight, bias = next(pairs)
    mean = np.maximum(x.mean((0, 1)) @ weight + bias, 0)
    weight, bias = next(pairs)
    joined = np.concatenate([np.broadcast_to(mean, (*own.shape[:2], len(mean))), own], axis=2)
    last, more = next(pairs)
    logits = np.maximum(joined @ weight + bias, 0) @ last + more
    others = np.delete(logits, PERSON, axis=2)
    odds = logits[..., PERSON] - np.log(np.exp(others - others.max()).sum(2)) - others.max()
    return 1 / (1 + np.exp(-_enlarged(_enlarged(odds, image.shape[0]).T, image.shape[1]).T))


def _block(x: Float64[np.ndarray, "h w c"], block: int, pairs: Pairs) -> Float64[np.ndarray, "h2 w2 d"]:
    wide = x
    if block:
        weight, bias = next(pairs)
        wide = np.clip(x @ weight + bias, 0, 6)
    weight, bias = next(pairs)
    windows = _windows(wide, 2 if block in REACHING else 1)
    seen = np.clip(sum(window * one for window, one in zip(windows, weight, strict=True)) + bias, 0, 6)
    if block in HALVED:
        seen = seen[::2, ::2]
    weight, bias = next(pairs)
    narrow = seen @ weight + bias
    return np.asarray(narrow + x if narrow.shape == x.shape else narrow)


def _windows(x: Float64[np.ndarray, "h w c"], reach: int) -> list[np.ndarray]:
    """The nine neighbours of each pixel, by rows, with zeros around the image."""
    height, width = x.shape[:2]
    padded = np.pad(x, ((reach, reach), (reach, reach), (0, 0)))
    steps = range(0, 3 * reach, reach)
    return [padded[i : i + height, j : j + width] for i in steps for j in steps]


def _enlarged(rows: Float64[np.ndarray, "n m"], count: int) -> Float64[np.ndarray, "count m"]:
    """Rows in between, so that the first and the last stay where they are."""
    at = np.linspace(0, len(rows) - 1, count)
    places = np.arange(len(rows))
    return np.stack([np.interp(at, places, column) for column in rows.T], axis=1)
