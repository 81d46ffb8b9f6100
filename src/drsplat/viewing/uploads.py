"""Pictures that came over the network."""

import io

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from ..errors import FormatError, InputError
from ..photos import PHOTO_FORMATS

MOST_BYTES, MOST_PIXELS = 20 << 20, 40_000_000


def picture_in(data: bytes) -> UInt8[np.ndarray, "_ _ 3"]:
    """RGB of a picture file in memory, upright, on black where it is transparent.

    Raises: InputError: too large. FormatError: damaged, or not a picture.
    """
    if len(data) > MOST_BYTES:
        raise InputError(f"a picture of {len(data):,} bytes: give one of up to {MOST_BYTES:,}")
    try:
        with Image.open(io.BytesIO(data), formats=PHOTO_FORMATS) as file:
            if file.width * file.height > MOST_PIXELS:
                raise InputError(
                    f"a picture of {file.width}x{file.height}: give one of up to {MOST_PIXELS:,} pixels"
                )
            picture = ImageOps.exif_transpose(file).convert("RGBA")
    except InputError:
        raise
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(
            f"this is no picture that can be read ({'/'.join(PHOTO_FORMATS)}): {error}"
        ) from error
    black = Image.new("RGBA", picture.size, (0, 0, 0, 255))
    return np.asarray(Image.alpha_composite(black, picture).convert("RGB"))
