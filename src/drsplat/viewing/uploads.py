"""Pictures that came over the network."""

import io

import numpy as np
from jaxtyping import UInt8

from ..errors import FormatError, InputError
from ..photos import decoded_picture

MOST_BYTES, MOST_PIXELS = 20 << 20, 40_000_000


def picture_in(data: bytes) -> UInt8[np.ndarray, "_ _ 3"]:
    """RGB of a picture file in memory, upright, on black where it is transparent.

    Raises: InputError: too large. FormatError: damaged, or not a picture.
    """
    if len(data) > MOST_BYTES:
        raise InputError(f"a picture of {len(data):,} bytes: give one of up to {MOST_BYTES:,}")
    try:
        return decoded_picture(io.BytesIO(data), MOST_PIXELS)
    except FormatError as error:
        raise FormatError(f"this is no picture, it {error}") from error
