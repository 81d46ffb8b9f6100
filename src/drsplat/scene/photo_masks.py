"""Masks of photos: white pixels are used, black ones are not, as in COLMAP, nerfstudio and brush."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from warnings import warn

import numpy as np
from PIL import Image

from ..base.arrays import Bool
from ..base.contents import open_file
from ..errors import DrSplatWarning, FormatError, MismatchError
from .photos import PHOTO_FORMATS, photo_size, undistort_ids
from .picture_costs import check_cost
from .views import View, same_aspect

MIN_WHITE = 128  # grey values from here on count as white
_WHITE = 255
_CACHED_MASKS = 1 << 16  # whether they are empty


def read_mask(path: Path) -> Image.Image:
    """Return a mask in grey. Raises: FormatError: it is missing, damaged, no picture, or too costly to decode."""
    try:
        with open_file(path) as file, Image.open(file, formats=PHOTO_FORMATS) as coded:
            check_cost(coded, file)
            return coded.convert("L")
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"{path}: cannot be read as a mask: {error}") from error


def load_mask(view: View) -> Bool[np.ndarray, "h w"] | None:
    """Return which pixels of `load_image` a view's mask keeps; None without a mask, which keeps all.

    A pixel of a smaller raster is kept if all that it shows is kept. The view's distortion is undone on the mask, too,
    and nothing outside the photo is kept.

    Raises: FormatError: a mask that cannot be read. MismatchError: a mask of another shape than the photo.
    """
    if view.mask_path is None:
        return None
    picture = read_mask(view.mask_path)
    _check_shape(picture, view)
    white = picture.point(lambda grey: _WHITE if (grey >= MIN_WHITE) != view.mask_inverted else 0)
    if white.size != (view.width, view.height):
        white = white.resize((view.width, view.height), Image.Resampling.BOX)
    mask: Bool[np.ndarray, "h w"] = np.asarray(white) == _WHITE
    if view.distortion is not None:
        mask = undistort_ids(view, mask.astype(np.int32)) == 1
    return mask


def views_with_something(views: Sequence[View]) -> list[View]:
    """Return the views whose masks keep a pixel, and those without masks.

    Warns: DrSplatWarning: names the photos whose masks leave all of them out. Raises: as `load_mask`.
    """
    empty = {view.name for view in views if keeps_nothing(view)}
    if empty:
        shown = ", ".join(sorted(empty)[:5]) + (f" and {len(empty) - 5} more" if len(empty) > 5 else "")
        warn(
            f"{len(empty)} of {len(views)} photos are not used, because their masks leave all of them out: {shown}. "
            "White is kept and black is left out; invert_masks=True turns that round",
            DrSplatWarning,
            stacklevel=3,
        )
    return [view for view in views if view.name not in empty]


def keeps_nothing(view: View) -> bool:
    """Return whether the mask of a view leaves all of its photo out. Raises: as `load_mask`."""
    if view.mask_path is None:
        return False
    try:
        stamp = view.mask_path.stat()
    except OSError as error:
        raise FormatError(f"{view.mask_path}: cannot be read as a mask: {error.strerror}") from error
    lens = None if view.distortion is None else (view.distortion, view.K.tobytes())
    return _is_empty(_MaskedView(view, (view.mask_path, stamp.st_mtime_ns, stamp.st_size, view.mask_inverted, lens)))


class _MaskedView:
    """View that equals other views with the same mask, raster and lens: the key of `_is_empty`."""

    def __init__(self, view: View, key: tuple[object, ...]) -> None:
        self.key = (*key, view.image_path, view.width, view.height)
        self.view = replace(view, cam_from_world=np.eye(4))

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _MaskedView) and self.key == other.key


@lru_cache(maxsize=_CACHED_MASKS)
def _is_empty(masked: _MaskedView) -> bool:
    mask = load_mask(masked.view)
    return mask is not None and not mask.any()


def _check_shape(picture: Image.Image, view: View) -> None:
    size = (view.width, view.height) if view.image_path is None else photo_size(view.image_path)
    if not same_aspect(picture.size, size):
        width, height = picture.size
        raise MismatchError(
            f"{view.mask_path}: the mask is {width}x{height}, its photo {size[0]}x{size[1]}: another aspect ratio. "
            "Make the mask of the photo as it is stored (uncropped, not rotated by EXIF)"
        )
