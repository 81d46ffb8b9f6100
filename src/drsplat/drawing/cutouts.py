"""One thing of a photo: cut out of it, the rest darkened, with a line of text below."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..arrays import Float32, Int64
from .pictures import FAINT, INK, PAPER, OtherPixels, Pixels

TILE, CAPTION = (320, 240), 44  # pixels: of the cut-out, and below it
MARGIN = 0.15  # of the sides of what is shown, around it
SMALLEST = 48.0  # pixels of a photo that fill a tile at least: fewer are a blur
DARK = 0.3  # of its own light, what is around the thing


def cut_out(photo: Pixels, share: Float32[np.ndarray, "h w"], size: tuple[int, int] = TILE) -> OtherPixels:
    """A tile of the part of a photo where `share` is above a half, its surroundings dark; all of it where nothing is.

    share: as of `visible_share`, at the photo's size. size: width and height of the tile, of 4 to 3.
    """
    kept = np.clip(share, 0, 1)[..., None]
    lit = np.clip(photo * (DARK + (1 - DARK) * kept), 0, 255).astype(np.uint8)
    left, top, right, bottom = _window(share)
    part = Image.fromarray(lit).crop((left, top, right, bottom))  # black where the window leaves the photo
    return np.asarray(part.resize(size, Image.Resampling.LANCZOS))


def captioned(tile: OtherPixels, title: str, note: str) -> OtherPixels:
    """A strip below the tile with a title, and a note below that; what is too long is cut."""
    height, width = tile.shape[:2]
    canvas = Image.new("RGB", (width, height + CAPTION), PAPER)
    canvas.paste(Image.fromarray(tile), (0, 0))
    draw = ImageDraw.Draw(canvas)
    for text, size, color, y in ((title, 16, INK, 13), (note, 12, FAINT, 32)):
        letters = ImageFont.load_default(size)
        draw.text((6, height + y), _fitting(text, letters, width - 12), color, letters, anchor="lm")
    return np.asarray(canvas)


def _window(share: Float32[np.ndarray, "h w"]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of what is shown, in the proportions of a tile, within the photo where it fits."""
    rows, columns = np.nonzero(share > 0.5 * min(1.0, float(share.max(initial=0))))
    if not len(rows):
        rows, columns = (np.array([0, side - 1]) for side in share.shape)
    high, wide = ((1 + 2 * MARGIN) * (np.ptp(np.percentile(at, (1, 99))) + 1) for at in (rows, columns))
    aspect = TILE[0] / TILE[1]
    whole = max(float(share.shape[1]), share.shape[0] * aspect)
    width = min(max(wide, high * aspect, SMALLEST), whole)
    left, right = _placed(columns, width, share.shape[1])
    top, bottom = _placed(rows, width / aspect, share.shape[0])
    return left, top, right, bottom


def _placed(at: Int64[np.ndarray, " n"], length: float, side: int) -> tuple[int, int]:
    """An interval about the middle of some pixels, moved into the photo; in the middle of it where it is longer."""
    begin = float(np.percentile(at, (1, 99)).mean()) + 0.5 - length / 2
    begin = min(max(begin, 0.0), side - length) if length <= side else (side - length) / 2
    return round(begin), round(begin + length)


def _fitting(text: str, letters: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> str:
    while letters.getlength(text) > width:
        text = text.rstrip("…")[:-1] + "…"
    return text
