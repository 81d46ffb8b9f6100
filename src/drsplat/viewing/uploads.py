"""Pictures that came over the network."""

import io
from typing import Any

import numpy as np

from ..arrays import UInt8
from ..errors import FormatError, InputError
from ..scene.photos import decoded_picture
from .messages import PART, UPLOAD

MOST_BYTES, MOST_PIXELS = 20 << 20, 40_000_000
MOST_PARTS = 64
MOST_UPLOADS = 1000
"""Of one connection. viser repeats a note of each part to all who come later, and forgets none."""


class Uploads:
    """What one browser sends: one picture at a time, of a size that was told and is kept to."""

    def __init__(self) -> None:
        self.count, self.name, self.left = 0, "", 0

    def passed(self, message: Any) -> Any:
        """The message as viser may have it, None for not at all.

        A picture that is too large is let in as an empty one, which is refused where others are.
        """
        if message["type"] == PART:
            return message if self._takes(message) else None
        return self._begun(message) if message["type"] == UPLOAD else message

    def _begun(self, message: Any) -> Any:
        if self.left > 0 or self.count >= MOST_UPLOADS:
            return None
        self.count += 1
        size, parts = message["size_bytes"], message["part_count"]
        if not 0 < size <= MOST_BYTES or not 0 < parts <= MOST_PARTS:
            return message | {"size_bytes": 0, "part_count": 0}
        self.name, self.left = message["transfer_uuid"], size
        return message

    def _takes(self, message: Any) -> bool:
        size = len(message["content"])
        if message["transfer_uuid"] != self.name or not 0 < size <= self.left:
            return False
        self.left -= size
        return True


def picture_in(data: bytes) -> UInt8[np.ndarray, "_ _ 3"]:
    """RGB of a picture file in memory, upright, on black where it is transparent.

    Raises: InputError: empty or too large. FormatError: damaged, or not a picture.
    """
    if not 0 < len(data) <= MOST_BYTES:
        raise InputError(f"expected a picture of 1 to {MOST_BYTES:,} bytes")
    try:
        return decoded_picture(io.BytesIO(data), MOST_PIXELS)
    except FormatError as error:
        raise FormatError(f"this is no picture, it {error}") from error
