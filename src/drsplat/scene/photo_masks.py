"""Masks of photos: white pixels are used, black ones are not, as in COLMAP, nerfstudio and brush."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from warnings import warn

import numpy as np
from PIL import Image

from ..base.arrays import GreyPixels, Mask, Pixels
from ..base.contents import open_file
from ..errors import DrSplatWarning, FormatError, MismatchError
from .photos import PHOTO_FORMATS, check_cost, photo_size, undistort_ids
from .views import View, same_aspect

MIN_WHITE = 128  # grey values from here on count as white
_WHITE = 255
_NEARLY = 8  # grey values that count as the same colour
_CACHED_MASKS = 1 << 16  # whether they are empty
_TRIED_MASKS = 20  # before an advice is given


def read_mask(path: Path) -> Image.Image:
    """Return a mask in grey, as the program means it that wrote it: what is `MIN_WHITE` or brighter is kept.

    Of a mask with transparency the alpha channel counts (brush), and grey as well where it is both black and white.
    Where nothing is white, all that is not black is kept, as in COLMAP and nerfstudio: masks of 0 and 1, and labels.
    Colours of a palette or on black are labels, too. JPEG, which loses values, is judged by `MIN_WHITE` alone.

    Raises: FormatError: it is missing, damaged, no picture, too costly to decode, or has colours and no black.
    """
    try:
        with open_file(path) as file, Image.open(file, formats=PHOTO_FORMATS) as coded:
            check_cost(coded, file)
            return Image.fromarray(_kept(coded))
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"{path}: cannot be read as a mask: {error}") from error


def _kept(coded: Image.Image) -> GreyPixels:
    """Return how white a mask is, from 0 to 255."""
    if "transparency" in coded.info or "A" in coded.getbands():
        rgba = np.asarray(coded.convert("RGBA"))
        if (rgba[..., 3] < _WHITE).any():
            return _of_alpha(rgba[..., :3].max(2), rgba[..., 3])
        coded = Image.fromarray(rgba[..., :3].copy())
    if coded.mode == "F" or coded.mode.startswith("I"):
        wide = np.nan_to_num(np.asarray(coded)).astype(np.float64)
        top = wide.max()
        grey = np.clip(wide * (_WHITE / top if 0 < top <= 1 or top > _WHITE else 1), 0, _WHITE).astype(np.uint8)
    elif coded.mode in ("RGB", "P"):
        grey = _of_colours(np.asarray(coded.convert("RGB")), is_palette=coded.mode == "P", lossy=coded.format == "JPEG")
    else:
        grey = np.asarray(coded.convert("L"))
    is_dark = coded.format != "JPEG" and grey.max() < MIN_WHITE
    return np.where(grey > 0, np.uint8(_WHITE), np.uint8(0)) if is_dark else grey


def _of_alpha(grey: GreyPixels, alpha: GreyPixels) -> GreyPixels:
    """Return a mask with transparency: a drawing of black and white on black, of anything else its alpha."""
    seen = grey[alpha >= MIN_WHITE]
    white, black = (seen >= _WHITE - _NEARLY).mean(), (seen <= _NEARLY).mean()
    return np.minimum(grey, alpha) if white and black and white + black == 1 else alpha


def _of_colours(rgb: Pixels, *, is_palette: bool, lossy: bool) -> GreyPixels:
    """Return the mask of a coloured picture: colours are labels of what is kept, and black is none."""
    brightest = rgb.max(2)
    if lossy or (brightest - rgb.min(2) <= _NEARLY).all():
        return np.asarray(Image.fromarray(rgb).convert("L"))
    if not is_palette and brightest.min() > _NEARLY:
        raise FormatError("it has colours and no black, no mask of two parts: paint what is kept white, the rest black")
    return np.where(brightest > _NEARLY, np.uint8(_WHITE), np.uint8(0))


def load_mask(view: View) -> Mask | None:
    """Return which pixels of `load_image` a view's mask keeps; None without a mask, which keeps all.

    A pixel of a smaller raster is kept if all that it shows is kept. The view's distortion is undone on the mask, too,
    and nothing outside the photo is kept.

    Raises: FormatError: a mask that cannot be read. MismatchError: a mask of another shape than the photo.
    """
    if view.mask_path is None:
        return None
    picture = read_mask(view.mask_path)
    size = view.size if view.image_path is None else photo_size(view.image_path)
    if not same_aspect(picture.size, size):
        width, height = picture.size
        raise MismatchError(
            f"{view.mask_path}: the mask is {width}x{height}, its photo {size[0]}x{size[1]}: another aspect ratio. "
            "Make the mask of the photo as it is stored (uncropped, not rotated by EXIF)"
        )
    white = picture.point(lambda grey: _WHITE if (grey >= MIN_WHITE) != view.mask_inverted else 0)
    if white.size != view.size:
        white = white.resize(view.size, Image.Resampling.BOX)
    mask: Mask = np.asarray(white) == _WHITE
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
            f"{_advice([view for view in views if view.mask_path is not None])}",
            DrSplatWarning,
            stacklevel=3,
        )
    return [view for view in views if view.name not in empty]


def _advice(masked: Sequence[View]) -> str:
    """Return what masks that leave all out mean, and what to do, once it has been tried on some of them."""
    tried = masked[:: -(-len(masked) // _TRIED_MASKS)]
    shares = [mask.mean() for view in tried if (mask := load_mask(view)) is not None]
    inverted = masked[0].mask_inverted
    other = "without invert_masks" if inverted else "invert_masks=True"
    meaning = "Black is kept and white is left out" if inverted else "White is kept and black is left out"
    if any(0 < share < 1 for share in shares):
        return f"{meaning}; if it is meant the other way, {other} keeps {1 - float(np.mean(shares)):.0%} of the photos"
    return (
        f"{meaning}, and these masks have one value all over, so that {other} would use the photos whole: make the "
        "masks anew, or take them away"
    )


def keeps_nothing(view: View) -> bool:
    """Return whether the mask of a view leaves all of its photo out. Raises: as `load_mask`."""
    if view.mask_path is None:
        return False
    try:
        stamp = view.mask_path.stat()
    except OSError as error:
        raise FormatError(f"{view.mask_path}: cannot be read as a mask: {error.strerror}") from error
    changes = (stamp.st_mtime_ns, stamp.st_size)
    return _is_empty(
        view.mask_path, changes, view.mask_inverted, view.image_path, view.size, view.distortion, view.K.tobytes()
    )


@lru_cache(maxsize=_CACHED_MASKS)
def _is_empty(
    mask: Path, changes: tuple[int, int], inverted: bool, photo: Path | None, size: tuple[int, int],
    distortion: tuple[float, float, float, float] | None, intrinsics: bytes,
) -> bool:  # fmt: skip
    K = np.frombuffer(intrinsics).reshape(3, 3)
    view = View("", K, np.eye(4), *size, photo, distortion, mask_path=mask, mask_inverted=inverted)
    kept = load_mask(view)
    return kept is not None and not kept.any()
