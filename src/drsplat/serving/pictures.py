"""Pictures as bytes, and bytes as pictures."""

import io

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from ..errors import InputError
from ..photos import PHOTO_FORMATS


def png(pixels: UInt8[np.ndarray, "h w 3"]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()


def decoded(data: bytes, most_pixels: int) -> UInt8[np.ndarray, "h w 3"]:
    """RGB of a picture's bytes, upright, on black where it is transparent.

    Raises: InputError: no picture, damaged, or of more pixels, judged by its header before it is decoded.
    """
    try:
        with Image.open(io.BytesIO(data), formats=PHOTO_FORMATS) as file:
            if file.width * file.height > most_pixels:
                raise InputError(
                    f"a picture of {file.width}x{file.height} pixels: at most {most_pixels:,} are taken, make it smaller"
                )
            picture = ImageOps.exif_transpose(file).convert("RGBA")
    except InputError:
        raise
    except Exception as error:  # decoders of damaged files raise anything
        raise InputError(
            f"the image cannot be read as one of {'/'.join(PHOTO_FORMATS)}: {type(error).__name__}"
        ) from error
    black = Image.new("RGBA", picture.size, (0, 0, 0, 255))
    return np.asarray(Image.alpha_composite(black, picture).convert("RGB"))
