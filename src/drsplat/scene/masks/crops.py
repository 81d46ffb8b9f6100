"""Crops of masks for encoders: the mask's box of the image, background black, padded to a square."""

import math
from collections.abc import Sequence
from typing import overload

import numpy as np

from ...base.arrays import Indices, Integer, Mask, OtherPixels, Pixels, UInt8
from ...errors import InputError
from .masks import Masks

MAX_PADDED_PIXELS = 6000 * 6000  # the whole of an ordinary photo is padded as it is

Crop = UInt8[np.ndarray, "_ _ 3"]


def crop(image: UInt8[np.ndarray, "H W 3"], part: Mask, box: Integer[np.ndarray, "4"] | Sequence[int]) -> Crop:
    """Return the pixels of a mask on black, in the middle of a square whose side is the longer one of its box.

    box: x0, y0, x1, y1, ends excluded. Odd padding puts the extra pixel at the right or below.

    Raises: InputError: a box that leaves the image or does not fit its part; a mask without pixels.
    Source: LangSplat preprocess.py, `get_seg_img` and `pad_img`. SAM's own boxes name the last row
    and column inclusively, so there each crop lacks one of both; ours has all. A box so long and thin that its square
    would have more than `MAX_PADDED_PIXELS`, and more than four times its own, is scaled down to that many first.
    """
    x0, y0, x1, y1 = (int(edge) for edge in box)
    height, width = part.shape
    inside = min(x0, y0) >= 0 and x1 <= image.shape[1] and y1 <= image.shape[0]
    if not inside or (width, height) != (x1 - x0, y1 - y0):
        raise InputError(
            f"a mask of {width}x{height} pixels for the box {x0} {y0} {x1} {y1} in an image of "
            f"{image.shape[1]}x{image.shape[0]}: expected a box of that size in the image"
        )
    if not part.any():
        raise InputError(f"the mask in the box {x0} {y0} {x1} {y1} has no pixel: leave it out")
    side, most = max(width, height), math.isqrt(max(MAX_PADDED_PIXELS, 4 * width * height))
    if side > most:
        return _padded(_shrunk(image[y0:y1, x0:x1], part, most / side))
    return _padded(image[y0:y1, x0:x1], part)


def _padded(pixels: Pixels, part: Mask | None = None) -> Crop:
    height, width = pixels.shape[:2]
    side = max(width, height)
    left, top = (side - width) // 2, (side - height) // 2
    square = np.zeros((side, side, 3), np.uint8)
    place = square[top : top + height, left : left + width]
    np.copyto(place, pixels, where=True if part is None else part[..., None])
    return square


def _shrunk(pixels: Pixels, part: Mask, scale: float) -> OtherPixels:
    height, width = (max(1, round(length * scale)) for length in part.shape)
    from PIL import Image

    shown = Image.fromarray(np.where(part[..., None], pixels, np.uint8(0)))
    return np.asarray(shown.resize((width, height), Image.Resampling.BOX))


class Crops(Sequence[Crop]):
    """Crops of an image's masks, each made on access; `crops` returns one.

    kept: rows of the masks that have pixels, ascending: crop i is of mask kept[i]. num_empty: masks
    left out because they have none.
    """

    def __init__(self, image: Pixels, masks: Masks) -> None:
        if image.shape[:2] != (masks.height, masks.width):
            raise InputError(
                f"masks of an image of {masks.width}x{masks.height} pixels, given with one of "
                f"{image.shape[1]}x{image.shape[0]}: give the image that was segmented"
            )
        self._image, self._masks = image, masks
        self.kept: Indices = np.array([row for row, part in enumerate(masks.parts) if part.any()], np.int64)
        self.num_empty = len(masks) - len(self.kept)

    def __len__(self) -> int:
        return len(self.kept)

    @overload
    def __getitem__(self, index: int) -> Crop: ...
    @overload
    def __getitem__(self, index: slice) -> list[Crop]: ...
    def __getitem__(self, index: int | slice) -> Crop | list[Crop]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        row = int(self.kept[index])
        return crop(self._image, self._masks.parts[row], self._masks.boxes[row])


def crops(image: Pixels, masks: Masks) -> Crops:
    """Return the crops of all masks that have pixels, in their order.

    Raises: InputError: the masks are of an image of another size.
    """
    return Crops(image, masks)
