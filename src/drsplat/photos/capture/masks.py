"""Masks of photos, brought into the capture.

People, a photographer's shadow, the gripper of a robot: anything that moves by itself or with the camera misleads
poses.
"""

from pathlib import Path

import numpy as np
from PIL import Image

from ...errors import MismatchError
from ...formats.replacing import replacing
from ...scene.photo_masks import MIN_WHITE, read_mask
from ...scene.views import same_aspect

_TRANSPOSE = {
    2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_270, 7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}  # fmt: skip
"""Operation that turns a photo of each EXIF orientation upright."""


def bring_mask(mask: Path, target: Path, size: tuple[int, int], orientation: int, invert: bool) -> bool:
    """Write a mask as 0 and 255 on the raster of its upright photo; return whether it keeps any of it.

    size: width and height of the upright photo. orientation: of the photo's EXIF; a mask of the shape of the photo as
    stored is turned with it, and one that is upright already stays.

    Raises: FormatError: no picture. MismatchError: of another shape than the photo.
    """
    picture = read_mask(mask)
    if (orientation > 4 and not same_aspect(picture.size, size)) or orientation in (2, 3, 4):
        picture = picture.transpose(_TRANSPOSE[orientation])
    if not same_aspect(picture.size, size):
        width, height = picture.size
        raise MismatchError(
            f"{mask}: the mask is {width}x{height}, its photo {size[0]}x{size[1]}: make it of the photo as it is"
        )
    used = np.asarray(picture.resize(size, Image.Resampling.NEAREST)) >= MIN_WHITE
    pixels = np.where(used != invert, np.uint8(255), np.uint8(0))
    with replacing(target, overwrite=True) as file:
        Image.fromarray(pixels).save(file, format="PNG")
    return bool(pixels.any())
