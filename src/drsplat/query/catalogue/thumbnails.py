"""Small pictures of objects, of a few kilobytes each."""

import io

import numpy as np
from PIL import Image

from ...base.arrays import UInt8

SIZE = (240, 180)
MAX_BYTES = 16 << 10
QUALITIES = (85, 70, 50, 30, 15)


def thumbnail(pixels: UInt8[np.ndarray, "_ _ 3"]) -> bytes:
    """Return a JPEG of at most MAX_BYTES, of the best quality that fits; the size is halved until one does."""
    picture = Image.fromarray(pixels)
    while True:
        for quality in QUALITIES:
            data = _jpeg(picture, quality)
            if len(data) <= MAX_BYTES:
                return data
        picture = picture.resize((max(picture.width // 2, 1), max(picture.height // 2, 1)))


def _jpeg(picture: Image.Image, quality: int) -> bytes:
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=quality, optimize=True)
    return file.getvalue()
