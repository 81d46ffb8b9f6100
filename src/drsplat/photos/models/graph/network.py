"""Learned network of `graph`: where objects end, and what each pixel has in common with others.

A U-Net: convolutions at a half, a quarter ... of the size, and back, joined by the features of each size. It is
trained in `world/segmenter/`.
"""

import hashlib
from collections.abc import Mapping
from importlib.resources import files

import numpy as np

from ....base.arrays import Float32, UInt8
from ....kernels.photo_regions import Layers, Sight
from ....kernels.photo_regions import look as look_through

LEVELS = 5
_BLOCKS = [f"down{level}" for level in range(LEVELS)] + [f"up{level}" for level in reversed(range(LEVELS - 1))]
_LAYERS = ["stem", *(f"{block}{part}" for block in _BLOCKS for part in "ab"), "head"]

Tensors = Mapping[str, Float32[np.ndarray, "..."]]


def shipped_network() -> tuple[Tensors, str]:
    """Return the weights in the package and the BLAKE2b hash of their file."""
    from safetensors.numpy import load

    data = (files(__package__) / "network.safetensors").read_bytes()
    weights = {name: array.astype(np.float32) for name, array in load(data).items()}
    return weights, hashlib.blake2b(data, digest_size=8).hexdigest()


def layers_of(weights: Tensors) -> Layers:
    """Return the weights in the order of use."""
    return tuple(weights[f"{layer}.{part}"] for layer in _LAYERS for part in ("weight", "bias"))


def look(image: UInt8[np.ndarray, "h w 3"], weights: Tensors, *, threads: int = 0) -> Sight:
    """Run the network on an image of any size; the result has the same bits at any `threads`.

    weights: stem, down<i>a, down<i>b, up<i>a, up<i>b and head, `.weight` and `.bias`.
    """
    return look_through(image, layers_of(weights), threads=threads)
