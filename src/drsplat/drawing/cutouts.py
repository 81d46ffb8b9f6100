"""Cut-outs: a photo's part that shows one object, in its colours on a pale ghost of the surroundings."""

import numpy as np
from PIL import Image

from ..base.arrays import Float32, Int64
from .palette import LUMA
from .pictures import FAINT, PAPER, OtherPixels, Pixels, border

TILE_PIXELS = (320, 240)  # width and height
MARGIN_SHARE = 0.15  # of the object's sides, around it
MIN_WIDTH_PIXELS = 48.0  # of a photo across a tile: fewer are a blur
GHOST_SHARE = 0.16  # of the photo's light in the surroundings; the rest is paper
OVERSAMPLING = 2  # tiles are composed at this factor, which smooths the outline
LINE_PIXELS = 3  # thickness of the outline before reduction


def cut_out(photo: Pixels, share: Float32[np.ndarray, "h w"], size: tuple[int, int] = TILE_PIXELS) -> OtherPixels:
    """Return a tile of the part of a photo where `share` is above a half, outlined; all of it if there is none.

    share: as of `visible_share`, at the photo's size. size: width and height of the tile, of 4 to 3.
    """
    window, fine = _window(share), (OVERSAMPLING * size[0], OVERSAMPLING * size[1])
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


def _window(share: Float32[np.ndarray, "h w"]) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom around the object: in a tile's proportions, in the photo where it fits."""
    rows, columns = np.nonzero(share > 0.5 * min(1.0, float(share.max(initial=0))))
    if not len(rows):
        rows, columns = (np.array([0, side - 1]) for side in share.shape)
    high, wide = ((1 + 2 * MARGIN_SHARE) * (np.ptp(np.percentile(at, (1, 99))) + 1) for at in (rows, columns))
    aspect = TILE_PIXELS[0] / TILE_PIXELS[1]
    whole = max(float(share.shape[1]), share.shape[0] * aspect)
    width = min(max(wide, high * aspect, MIN_WIDTH_PIXELS), whole)
    left, right = _placed(columns, width, share.shape[1])
    top, bottom = _placed(rows, width / aspect, share.shape[0])
    return left, top, right, bottom


def _placed(at: Int64[np.ndarray, " n"], length: float, side: int) -> tuple[int, int]:
    """Return an interval about the middle of some pixels: moved into the photo, or centred where it is longer."""
    begin = float(np.percentile(at, (1, 99)).mean()) + 0.5 - length / 2
    begin = min(max(begin, 0.0), side - length) if length <= side else (side - length) / 2
    return round(begin), round(begin + length)
