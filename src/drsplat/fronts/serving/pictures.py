"""Pictures as bytes, and bytes as pictures."""

import base64
import binascii
import io

from PIL import Image

from ...base.arrays import Pixels
from ...errors import FormatError, InputError
from ...scene.photos import decoded_picture


def png(pixels: Pixels) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()


def jpeg(pixels: Pixels) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=90)
    return buffer.getvalue()


def decoded(data: bytes, most_pixels: int) -> Pixels:
    """Return RGB of a picture's bytes, upright, on black where it is transparent.

    Raises: InputError: no picture, damaged, or of more pixels, judged by its header before it is decoded.
    """
    try:
        return decoded_picture(io.BytesIO(data), most_pixels)
    except FormatError as error:
        raise InputError(f"the image {error}") from error


def from_base64(text: str, name: str) -> bytes:
    """Return the bytes of a text in base64. name: of the field that it is of. Raises: InputError: it is no base64."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"{name}: expected base64: {error}") from None
