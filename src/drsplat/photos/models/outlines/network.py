"""Network that sees outlines: `graph`'s U-Net with other weights, of which only the borders are used."""

import hashlib
from functools import cache
from importlib.resources import files

import numpy as np
from PIL import Image

from ....base.arrays import Float32, UInt8
from ....errors import InputError
from ....kernels.photo_regions import BORDER_STEPS, Layers
from ....kernels.photo_regions import look as look_through
from ..graph.network import layers_of
from ..graph.regions import working_image


@cache
def shipped_outlines() -> tuple[Layers, str]:
    """Return the layers in the package and the BLAKE2b hash of their file."""
    from safetensors.numpy import load

    data = (files(__package__) / "network.safetensors").read_bytes()
    weights = {name: array.astype(np.float32) for name, array in load(data).items()}
    return layers_of(weights), hashlib.blake2b(data, digest_size=8).hexdigest()


def outlines(image: UInt8[np.ndarray, "h w 3"], *, threads: int = 0) -> Float32[np.ndarray, "h w"]:
    """Return the strength of an outline at each pixel, 0 to 1; the same bits at any `threads`.

    It is the mean of what the network sees in the image and in the image at half its size. Images of more than 640x480
    pixels are seen at that size, so that memory is bounded, and their outlines enlarged.

    Raises: InputError: an image without pixels.
    """
    height, width = image.shape[:2]
    if not height * width:
        raise InputError(f"an image of {width}x{height} pixels: expected at least 1x1")
    full = Image.fromarray(working_image(image))
    half = full.resize(((full.width + 1) // 2, (full.height + 1) // 2), Image.Resampling.BOX)
    seen = [_strength(part, (width, height), threads) for part in (full, half)]
    return np.asarray((seen[0] + seen[1]) / 2, np.float32)


def _strength(image: Image.Image, size: tuple[int, int], threads: int) -> Float32[np.ndarray, "h w"]:
    borders = look_through(np.asarray(image), shipped_outlines()[0], threads=threads).borders
    strength = Image.fromarray(np.asarray(borders, np.float32) / np.float32(BORDER_STEPS))
    return np.asarray(strength.resize(size, Image.Resampling.BILINEAR))
