"""Finding people in a photo, as DeepLabv3 on MobileNetV2 sees it."""

from functools import cache
from pathlib import Path

import numpy as np
from scipy import ndimage

from ....base.arrays import MaskIds, Pixels
from ....errors import InputError
from ....formats.tensors import map_tensors
from ....kernels import photo_regions
from ....kernels.photo_regions import Layers

SIDE_PIXELS = 513  # that the network was taught at
BEYOND = 128  # grey around photos that are no squares, as when it was taught
SURE, POSSIBLE = 0.8, 0.3
"""Likelihoods of pixels where somebody is, and of those around, which belong to them."""
REACH_PIXELS = 24  # from sure pixels to possible ones
GROWN_PIXELS = 4  # beyond what is possible: hair, and the blur of a border


def people(image: Pixels, *, threads: int = 0) -> MaskIds:
    """Return the number of the person, or of the group, that each pixel shows; 0 for nobody.

    image: of at most SIDE_PIXELS a side; larger people are found better. The result is the same at any `threads`.

    Raises: InputError: a larger image.
    """
    height, width = image.shape[:2]
    if max(height, width) > SIDE_PIXELS:
        raise InputError(f"an image of {width}x{height} pixels: expected at most {SIDE_PIXELS} a side")
    framed = np.full((SIDE_PIXELS, SIDE_PIXELS, 3), BEYOND, np.uint8)
    framed[:height, :width] = image
    likely = photo_regions.people(framed, shipped_layers(), threads=threads)[:height, :width]
    shown = ndimage.binary_dilation(likely > SURE, iterations=REACH_PIXELS, mask=likely > POSSIBLE)
    return np.asarray(ndimage.label(ndimage.binary_dilation(shown, iterations=GROWN_PIXELS))[0], np.int32)


@cache
def shipped_layers() -> Layers:
    """Return the layers in the package."""
    parts = map_tensors(Path(__file__).with_name("network.safetensors"))[0]
    layers: list[np.ndarray] = []
    for name in sorted({key.partition(".")[0] for key in parts}):
        step, zero = parts[f"{name}.scale"]
        layers += [(parts[f"{name}.weight"].astype(np.float32) - zero) * step, parts[f"{name}.bias"]]
    return tuple(layers)
