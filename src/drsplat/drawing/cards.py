"""Sheets of cards: a picture with a title and notes below it, side by side under a heading, on white.

The picture may be a cut-out: a photo's part that shows one object, in its colours on a pale ghost of the surroundings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..base.arrays import Indices, OtherPixels, PixelNumbers, Pixels
from .heat import LUMA
from .pictures import FAINT, INK, PAPER, border, fitting

TILE_PIXELS = (320, 240)  # width and height
MARGIN_SHARE = 0.15  # of the object's sides, around it
MIN_WIDTH_PIXELS = 48.0  # of a photo across a tile: fewer are a blur
GHOST_SHARE = 0.16  # of the photo's light in the surroundings; the rest is paper
OVERSAMPLING = 2  # tiles are composed at this factor, which smooths the outline
LINE_PIXELS = 3  # thickness of the outline before reduction


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


def cut_out(photo: Pixels, share: PixelNumbers, size: tuple[int, int] = TILE_PIXELS) -> OtherPixels:
    """Return a tile of the part of a photo where `share` is above a half, outlined; all of it if there is none.

    share: as of `visible_share`, at the photo's size. size: width and height of the tile, of 4 to 3.
    """
    # left, top, right and bottom around the object: in a tile's proportions, in the photo where it fits
    rows, columns = np.nonzero(share > 0.5 * min(1.0, float(share.max(initial=0))))
    if not len(rows):
        rows, columns = (np.array([0, side - 1]) for side in share.shape)
    high, wide = ((1 + 2 * MARGIN_SHARE) * (np.ptp(np.percentile(at, (1, 99))) + 1) for at in (rows, columns))
    aspect = TILE_PIXELS[0] / TILE_PIXELS[1]
    whole = max(float(share.shape[1]), share.shape[0] * aspect)
    width = min(max(wide, high * aspect, MIN_WIDTH_PIXELS), whole)
    left, right = _placed(columns, width, share.shape[1])
    top, bottom = _placed(rows, width / aspect, share.shape[0])
    window, fine = (left, top, right, bottom), (OVERSAMPLING * size[0], OVERSAMPLING * size[1])
    part = np.asarray(_cropped(Image.fromarray(photo), window, fine), np.float32)
    visible = np.asarray(_cropped(Image.fromarray(np.clip(share, 0, 1)), window, fine))
    ghost = 255 - GHOST_SHARE * (255 - part @ LUMA.astype(np.float32))[..., None]
    tile = (part * visible[..., None] + ghost * (1 - visible[..., None])).clip(0, 255).astype(np.uint8)
    tile[border(visible > 0.5, LINE_PIXELS)] = FAINT
    return np.asarray(Image.fromarray(tile).reduce(OVERSAMPLING))


def _cropped(picture: Image.Image, window: tuple[int, int, int, int], size: tuple[int, int]) -> Image.Image:
    """Return the window of a picture; beyond it a photo is paper, and a share 0."""
    left, top, right, bottom = window
    canvas = Image.new(picture.mode, (right - left, bottom - top), PAPER if picture.mode == "RGB" else 0)
    canvas.paste(picture, (-left, -top))
    return canvas.resize(size, Image.Resampling.BICUBIC)


def _placed(at: Indices, length: float, side: int) -> tuple[int, int]:
    """Return an interval about the middle of some pixels: moved into the photo, or centred where it is longer."""
    begin = float(np.percentile(at, (1, 99)).mean()) + 0.5 - length / 2
    begin = min(max(begin, 0.0), side - length) if length <= side else (side - length) / 2
    return round(begin), round(begin + length)
