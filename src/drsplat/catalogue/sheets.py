"""A picture of what a catalogue answered."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from ..drawing.cutouts import captioned
from ..drawing.pictures import OtherPixels, contact_sheet
from ..errors import InputError
from .entries import Entry
from .thumbnails import SIZE

COLUMNS, MOST = 5, 60
GREY = 214  # of an object that could not be drawn


def entry_sheet(entries: Sequence[Entry]) -> OtherPixels:
    """The first 60 objects with their scenes. Raises: InputError: none. FormatError: a damaged thumbnail."""
    if not entries:
        raise InputError("there is nothing to draw: no object answers this query")
    tiles = [
        captioned(_tile(entry), f"{entry.score:.2f} {entry.title}", f"{entry.scene} {entry.photo or ''}")
        for entry in entries[:MOST]
    ]
    return contact_sheet(tiles, min(COLUMNS, len(tiles)), tile_width=tiles[0].shape[1])


def _tile(entry: Entry) -> OtherPixels:
    if entry.thumbnail is None:
        return np.full((SIZE[1], SIZE[0], 3), GREY, np.uint8)
    return np.asarray(Image.fromarray(entry.picture()).resize(SIZE))
