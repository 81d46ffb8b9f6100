"""Masks beside photos: white is kept, black is left out, as COLMAP, nerfstudio and brush have it.

People, a photographer's shadow, the gripper of a robot: what moves with the camera, or by itself, misleads poses.
"""

from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..contents import open_file
from ..errors import FormatError, MismatchError
from ..formats.replacing import replacing
from ..scene.photos import PHOTO_FORMATS
from ..scene.picture_costs import check_cost
from ..scene.views import same_aspect

FOLDER, SUFFIX = "masks", ".png"
KEPT_FROM = 128  # of 255
_TRANSPOSE = {
    2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_270, 7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}  # fmt: skip
"""How a photo of each EXIF orientation is brought upright."""


def mask_folder(photos: Path) -> Path | None:
    """Return the folder of the photos' masks: masks/ in theirs, or beside it where theirs is named images."""
    places = [photos / FOLDER] + ([photos.parent / FOLDER] if photos.name == "images" else [])
    return next((place for place in places if place.is_dir()), None)


def mask_of(masks: Path | None, name: str) -> Path | None:
    """Return the mask of a photo: NAME.png, as COLMAP has it (a.jpg.png), or the photo's name with .png (a.png)."""
    if masks is None:
        return None
    path = PurePosixPath(name)
    names = (name + SUFFIX, str(path.with_suffix(SUFFIX)))
    return next((masks / each for each in names if (masks / each).is_file()), None)


def bring_mask(mask: Path, target: Path, size: tuple[int, int], orientation: int, invert: bool) -> None:
    """Write a mask as 0 and 255 on the raster of its upright photo.

    size: width and height of the upright photo. orientation: of the photo's EXIF; a mask of the shape of the photo as
    stored is turned with it, and one that is upright already stays.

    Raises: FormatError: no picture. MismatchError: of another shape than the photo.
    """
    picture = _read(mask)
    if (orientation > 4 and not same_aspect(picture.size, size)) or orientation in (2, 3, 4):
        picture = picture.transpose(_TRANSPOSE[orientation])
    if not same_aspect(picture.size, size):
        width, height = picture.size
        raise MismatchError(
            f"{mask}: the mask is {width}x{height}, its photo {size[0]}x{size[1]}: make it of the photo as it is"
        )
    kept = _kept(picture.resize(size, Image.Resampling.NEAREST), invert)
    with replacing(target, overwrite=True) as file:
        Image.fromarray(kept).save(file, format="PNG")


def _kept(picture: Image.Image, invert: bool) -> UInt8[np.ndarray, "h w"]:
    white = np.asarray(picture) >= KEPT_FROM
    return np.where(white != invert, np.uint8(255), np.uint8(0))


def _read(mask: Path) -> Image.Image:
    try:
        with open_file(mask) as file, Image.open(file, formats=PHOTO_FORMATS) as coded:
            check_cost(coded, file)
            return coded.convert("L")
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"{mask}: cannot be read as a mask: {error}") from error
