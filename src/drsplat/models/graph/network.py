"""What a learned network sees in a photo: where things end, and what each pixel has in common with others.

A U-Net: convolutions at a half, a quarter ... of the size, and back, with what was seen at each size put beside it. It
is learned in `world/segmenter/`.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from ...kernels.algebra import dense_rows
from ..convolving import convolve

LEVELS = 5
TRAITS = 8
TRAIT_STEPS, BORDER_STEPS = 32, 255
"""Of one unit: whole numbers, so that sums over pixels are exact."""
MOST = 127 * TRAIT_STEPS

Tensors = Mapping[str, Float32[np.ndarray, "..."]]


@dataclass(frozen=True, eq=False)
class Sight:
    """borders: how likely a pixel touches another thing, 0 to BORDER_STEPS. traits: near for pixels of one thing."""

    borders: Int32[np.ndarray, "h w"]
    traits: Int32[np.ndarray, "h w t"]


def shipped_network() -> tuple[Tensors, str]:
    """Its weights from the package, and the BLAKE2b hash of their file."""
    from safetensors.numpy import load

    data = (files(__package__) / "network.safetensors").read_bytes()
    weights = {name: array.astype(np.float32) for name, array in load(data).items()}
    return weights, hashlib.blake2b(data, digest_size=8).hexdigest()


def look(image: UInt8[np.ndarray, "h w 3"], weights: Tensors, *, threads: int = 0) -> Sight:
    """Return what the network sees in an image of any size; the same bits at any `threads`.

    weights: stem, down<i>a, down<i>b, up<i>a, up<i>b as `convolve` has them, `.weight` and `.bias`; head (C, 4 (1 +
    TRAITS)): for each pixel of a 2x2 block, rows first, within each channel.
    """
    height, width = image.shape[:2]
    step = 2**LEVELS
    padding = ((0, -height % step), (0, -width % step), (0, 0))
    pixels = np.pad(image, padding, mode="edge").astype(np.float32) / np.float32(127.5) - 1
    out = _head(_middle(_apart(pixels)[None], weights, threads)[0], weights, threads)[:height, :width]
    likely = 1 / (1 + np.exp(-out[..., 0].astype(np.float64)))
    traits = np.clip(np.rint(out[..., 1:] * TRAIT_STEPS), -MOST, MOST).astype(np.int32)
    return Sight(np.rint(likely * BORDER_STEPS).astype(np.int32), traits)


def _middle(x: Float32[np.ndarray, "1 h w c"], weights: Tensors, threads: int) -> Float32[np.ndarray, "1 h w d"]:
    x, seen = _convolved(x, "stem", weights, threads), []
    for level in range(LEVELS):
        x = _block(_pooled(x) if level else x, f"down{level}", weights, threads)
        seen.append(x)
    for level in reversed(range(LEVELS - 1)):
        both = np.concatenate([seen[level], x.repeat(2, 1).repeat(2, 2)], axis=3)
        x = _block(both, f"up{level}", weights, threads)
    return x


def _block(
    x: Float32[np.ndarray, "1 h w c"], name: str, weights: Tensors, threads: int
) -> Float32[np.ndarray, "1 h w d"]:
    return _convolved(_convolved(x, f"{name}a", weights, threads), f"{name}b", weights, threads)


def _convolved(
    x: Float32[np.ndarray, "1 h w c"], name: str, weights: Tensors, threads: int
) -> Float32[np.ndarray, "1 h w d"]:
    return convolve(x, weights[f"{name}.weight"], weights[f"{name}.bias"], threads=threads)


def _head(x: Float32[np.ndarray, "h w c"], weights: Tensors, threads: int) -> Float32[np.ndarray, "h2 w2 t"]:
    height, width, count = x.shape
    rows = dense_rows(x.reshape(-1, count), weights["head.weight"], threads=threads) + weights["head.bias"]
    return _together(rows.reshape(height, width, -1))


def _pooled(x: Float32[np.ndarray, "1 h w c"]) -> Float32[np.ndarray, "1 h2 w2 c"]:
    _, height, width, count = x.shape
    return np.asarray(x.reshape(1, height // 2, 2, width // 2, 2, count).max((2, 4)))


def _apart(x: Float32[np.ndarray, "h w c"]) -> Float32[np.ndarray, "h2 w2 d"]:
    """The four pixels of each 2x2 block as channels."""
    height, width, count = x.shape
    blocks = x.reshape(height // 2, 2, width // 2, 2, count).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(blocks.reshape(height // 2, width // 2, 4 * count))


def _together(x: Float32[np.ndarray, "h w d"]) -> Float32[np.ndarray, "h2 w2 c"]:
    """Undoes `_apart`."""
    height, width, count = x.shape
    blocks = x.reshape(height, width, count // 4, 2, 2).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(blocks.reshape(2 * height, 2 * width, count // 4))
