"""Picture of a catalogue's answer."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from ...base.arrays import OtherPixels
from ...drawing.cards import Card, card_sheet
from ...errors import InputError
from .entries import Entry
from .rows import SIZE

COLUMNS, MAX_CARDS = 5, 60
GREY = 214  # of an object without a thumbnail


def entry_sheet(entries: Sequence[Entry], heading: str) -> OtherPixels:
    """Draw a card for each of the first 60 entries. Raises: InputError: none. FormatError: a damaged thumbnail."""
    if not entries:
        raise InputError("there is nothing to draw: no object answers this query")
    cards = [
        Card(_tile(entry), entry.title, (f"in {entry.scene}", f"score {entry.score:.2f} · {entry.photo or 'no photo'}"))
        for entry in entries[:MAX_CARDS]
    ]
    return card_sheet(cards, COLUMNS, heading, "Best first.")


def _tile(entry: Entry) -> OtherPixels:
    if entry.thumbnail is None:
        return np.full((SIZE[1], SIZE[0], 3), GREY, np.uint8)
    return np.asarray(Image.fromarray(entry.picture()).resize(SIZE))
