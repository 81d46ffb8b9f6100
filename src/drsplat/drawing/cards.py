"""Sheets of cards: a picture with a title and notes below it, side by side under a heading, on white."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .pictures import FAINT, INK, PAPER, OtherPixels, fitting

FRAME_COLOR = (214, 217, 223)
GAP_PIXELS, MARGIN_PIXELS, PADDING_PIXELS = 16, 24, 10  # between cards, around the sheet, of text in a card
TITLE_PIXELS, NOTE_PIXELS, HEADING_PIXELS = 18, 14, 30  # heights of letters
LINE_SPACING = 1.45  # of the height of letters


@dataclass(frozen=True, eq=False)
class Card:
    """Picture with a title and further lines of text."""

    pixels: OtherPixels
    title: str
    notes: Sequence[str] = ()


def card_sheet(cards: Sequence[Card], columns: int, heading: str, note: str = "") -> OtherPixels:
    """Return cards of one size in rows under a heading. Text that is too long ends in an ellipsis."""
    drawn = [_drawn(card) for card in cards]
    columns = min(columns, len(drawn))
    wide, high = drawn[0].size
    top = MARGIN_PIXELS + sum(round(LINE_SPACING * size) for size in (HEADING_PIXELS, NOTE_PIXELS)) + GAP_PIXELS
    width = 2 * MARGIN_PIXELS + columns * (wide + GAP_PIXELS) - GAP_PIXELS
    height = top + -(-len(drawn) // columns) * (high + GAP_PIXELS) - GAP_PIXELS + MARGIN_PIXELS
    sheet = Image.new("RGB", (width, height), PAPER)
    _write(sheet, MARGIN_PIXELS, MARGIN_PIXELS, [(heading, HEADING_PIXELS, INK), (note, NOTE_PIXELS, FAINT)])
    for number, card in enumerate(drawn):
        row, column = divmod(number, columns)
        sheet.paste(card, (MARGIN_PIXELS + column * (wide + GAP_PIXELS), top + row * (high + GAP_PIXELS)))
    return np.asarray(sheet)


def _drawn(card: Card) -> Image.Image:
    height, width = card.pixels.shape[:2]
    lines = [(card.title, TITLE_PIXELS, INK), *((note, NOTE_PIXELS, FAINT) for note in card.notes)]
    text = sum(round(LINE_SPACING * size) for _, size, _ in lines) + 2 * PADDING_PIXELS
    drawn = Image.new("RGB", (width + 2, height + 2 + text), PAPER)
    drawn.paste(Image.fromarray(card.pixels), (1, 1))
    pen = ImageDraw.Draw(drawn)
    pen.rectangle((0, 0, drawn.width - 1, drawn.height - 1), outline=FRAME_COLOR)
    pen.line((0, height + 1, drawn.width, height + 1), FRAME_COLOR)
    _write(drawn, PADDING_PIXELS, height + 1 + PADDING_PIXELS, lines)
    return drawn


def _write(picture: Image.Image, left: int, top: int, lines: Sequence[tuple[str, int, tuple[int, int, int]]]) -> None:
    """Draw lines of text of some heights and colours, one below the other."""
    pen, room = ImageDraw.Draw(picture), float(picture.width - 2 * left)
    for text, size, color in lines:
        letters, line = ImageFont.load_default(size), round(LINE_SPACING * size)
        pen.text((left, top + line / 2), fitting(pen, text, letters, room), color, letters, anchor="lm")
        top += line
