"""Photos, each checked and copied into the capture: upright, in a common format, with its facts.

The photos' own folder is only read. A photo that is upright already and a plain JPEG or PNG is copied byte for byte.

Masks come along: people, a photographer's shadow, the gripper of a robot, anything that moves by itself or with the
camera misleads poses.

Facts in a photo's EXIF: its camera, its place on the Earth and how it was held.

Source: CIPA DC-008 (Exif 2.32) for the tags; ExifTool's documentation of Apple's maker notes for the acceleration.
"""

import math
import shutil
import struct
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError
from scipy import ndimage

from ...base.arrays import GreyPixels
from ...base.contents import open_file
from ...errors import FormatError, MismatchError, MissingExtraError, pip_install
from ...formats.mask_files import FOLDER as MASKS
from ...formats.mask_files import SUFFIX as MASK_SUFFIX
from ...formats.mask_files import is_inverted
from ...formats.replacing import replacing
from ...formats.scenes import STILL_BRANDS
from ...formats.tensors import hash_file
from ...scene.photo_masks import MIN_WHITE, read_mask
from ...scene.photos import PHOTO_FORMATS, check_cost, is_wide, orientation_of, rgb_of
from ...scene.views import same_aspect
from .finding import Source

MAKE_TAG, MODEL_TAG, ORIENTATION_TAG = 271, 272, 274
EXIF_IFD_TAG, GPS_IFD_TAG = 0x8769, 0x8825
FOCAL_MM_TAG, FOCAL_35MM_TAG, LENS_MODEL_TAG, MAKER_NOTE_TAG = 37386, 41989, 42036, 37500
DIAGONAL_35MM_FILM_MM = math.hypot(36, 24)
FOCAL_SHARE_BOUNDS = (0.2, 20.0)  # of the diagonal: other focal lengths are errors
MAX_HEIGHT_M = 20_000.0
APPLE_SIGNATURE = b"Apple iOS\0"
APPLE_ACCELERATION_TAG = 0x0008
SIGNED_RATIONAL_TYPE = 10
MAX_ENTRIES = 200  # of a maker note


@dataclass(frozen=True)
class ExifFacts:
    """Facts that a photo states; None where it states nothing, or nothing sensible.

    camera: make, model and lens, as one text; photos with the same one share intrinsics. focal_share: focal length
    as a share of the photo's diagonal. position: longitude and latitude in degrees, height in metres (None if not
    stated). down: unit vector of gravity in the camera's axes of the photo as stored (+x right, +y down, +z forward).
    """

    camera: str = ""
    focal_share: float | None = None
    position: tuple[float, float, float | None] | None = None
    down: tuple[float, float, float] | None = None


def exif_facts(photo: Image.Image) -> ExifFacts:
    """Read the facts of an opened photo; a damaged EXIF block has none."""
    try:
        exif = photo.getexif()
        tags, gps = dict(exif.get_ifd(EXIF_IFD_TAG)), dict(exif.get_ifd(GPS_IFD_TAG))
    except Exception:  # parsers of damaged blocks raise anything
        return ExifFacts()
    camera = [
        _text(value)
        for value in (exif.get(MAKE_TAG), exif.get(MODEL_TAG), tags.get(LENS_MODEL_TAG), tags.get(FOCAL_MM_TAG))
    ]
    share = _number(tags.get(FOCAL_35MM_TAG)) / DIAGONAL_35MM_FILM_MM
    return ExifFacts(
        camera=" ".join(part for part in camera if part),
        focal_share=(share if FOCAL_SHARE_BOUNDS[0] <= share <= FOCAL_SHARE_BOUNDS[1] else None),
        position=_position(gps),
        down=_apple_down(tags.get(MAKER_NOTE_TAG)),
    )


def _position(gps: dict[int, Any]) -> tuple[float, float, float | None] | None:
    """Return longitude, latitude and height of the GPS block (tags 1 to 6)."""
    latitude, longitude = _degrees(gps.get(2), gps.get(1), b"S"), _degrees(gps.get(4), gps.get(3), b"W")
    if not (abs(latitude) <= 90 and abs(longitude) <= 180) or (latitude == 0 and longitude == 0):
        return None
    height = _number(gps.get(6))
    below = gps.get(5) in (1, b"\x01")
    return longitude, latitude, (-height if below else height) if abs(height) <= MAX_HEIGHT_M else None


def _degrees(parts: Any, side: Any, negative: bytes) -> float:
    """Convert degrees, minutes and seconds to degrees; NaN for anything else."""
    try:
        degrees, minutes, seconds = (_number(part) for part in parts)
    except (TypeError, ValueError):
        return math.nan
    total = degrees + minutes / 60 + seconds / 3600
    return -total if _text(side).upper().encode() == negative else total


def _apple_down(note: Any) -> tuple[float, float, float] | None:
    """Return gravity from an iPhone's maker note, in the camera's axes.

    The phone's axes: +x to the right of its screen, +y to its top, +z out of its face; upright it says (0, -1, 0). The
    camera on its back looks along -z, and the stored photo has its right along the phone's -y and its down along -x.
    """
    if not isinstance(note, bytes) or not note.startswith(APPLE_SIGNATURE):
        return None
    with suppress(struct.error, ZeroDivisionError):
        (count,) = struct.unpack_from(">H", note, 14)
        for at in range(16, 16 + 12 * min(count, MAX_ENTRIES), 12):
            tag, kind, number, offset = struct.unpack_from(">HHII", note, at)
            if (tag, kind, number) == (APPLE_ACCELERATION_TAG, SIGNED_RATIONAL_TYPE, 3):
                numbers = struct.unpack_from(">6i", note, offset)
                x, y, z = (a / b for a, b in zip(numbers[::2], numbers[1::2], strict=True))
                length = math.hypot(x, y, z)
                return (-y / length, -x / length, -z / length) if 0.5 < length < 2 else None
    return None


def _number(value: Any) -> float:
    """Return a finite number, or NaN."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return "" if value is None else str(value).replace("\0", "").strip()


Vector = tuple[float, float, float]

MAX_PIXELS = 200_000_000
MIN_SIDE_PIXELS = 64
JPEG_QUALITY = 95
ALL_LEFT_OUT = "its mask leaves all of it out: white is kept and black is left out, with invert_masks=True the reverse"
LOOK_SIDE_PIXELS = 512  # of the small picture for measuring sharpness
DIGEST_LETTERS = 24
_BLOCK_BYTES = 1 << 20
# per EXIF orientation, right and down of the upright photo in (right, down) of the stored one
_TURNS = {1: ((1, 0), (0, 1)), 3: ((-1, 0), (0, -1)), 6: ((0, -1), (1, 0)), 8: ((0, 1), (-1, 0))}


@dataclass(frozen=True)
class Photo:
    """Photo in the capture, or the reason why it could not be used (`fault`).

    name: in the input folder. file: its name while the capture is made, from its contents, so equal photos are one
    file. width, height: upright, in pixels. sharpness: standard deviation of the Laplacian of a small copy, in grey
    levels.
    """

    name: str
    file: str = ""
    width: int = 0
    height: int = 0
    sharpness: float = 0.0
    exif: ExifFacts = field(default_factory=ExifFacts)
    fault: str | None = None


def bring(source: Source, folder: Path, invert_masks: bool = False) -> Photo:
    """Check a photo, write it upright into a folder under a name made of its digest, and return its record.

    Its mask is written to the folder `masks` beside it, and becomes part of its name.

    Raises: InputError: it cannot be written. MismatchError, FormatError: of a mask. MissingExtraError: HEIC, and
    pi-heif is not installed.
    """
    invert = source.mask is not None and invert_masks != is_inverted(source.mask)
    try:
        upright, suffix, orientation, photo = _decoded(source)
    except FormatError as error:
        return Photo(source.name, fault=str(error).removeprefix(f"{source.path}: "))
    digest = hash_file(source.path)[:DIGEST_LETTERS]
    if source.mask is not None:
        digest += f"_{hash_file(source.mask)[:8]}{'_inverted' if invert else ''}"
    path = folder / (digest + suffix)
    with open_file(source.path) as file, replacing(path, overwrite=True) as output:
        if upright is None:
            shutil.copyfileobj(file, output, _BLOCK_BYTES)
        elif suffix == ".jpg":
            upright.save(output, format="JPEG", quality=JPEG_QUALITY, subsampling=0)
        else:
            upright.save(output, format="PNG")
    if source.mask is not None:
        target = mask_path(folder, path.name)
        if not bring_mask(source.mask, target, (photo.width, photo.height), orientation, invert):
            path.unlink()
            target.unlink()
            return Photo(source.name, fault=ALL_LEFT_OUT)
    return replace(photo, file=path.name)


def mask_path(folder: Path, file: str) -> Path:
    """Return where the mask of a photo in the folder is, named as COLMAP expects it."""
    return folder.parent / MASKS / (file + MASK_SUFFIX)


def sharpness(grey: GreyPixels) -> float:
    """Return the standard deviation of the Laplacian of a picture of some 512 pixels, in grey levels."""
    laplacian = ndimage.laplace(grey.astype(np.float32))[1:-1, 1:-1]
    return float(laplacian.std()) if laplacian.size else 0.0


def _decoded(source: Source) -> tuple[Image.Image | None, str, int, Photo]:
    """Decode a photo of any format.

    Returns: the picture if it has to be written anew, None to copy the file; the suffix of its file; the orientation
    that it was stored in; its record, without a file. Raises: FormatError, MissingExtraError.
    """
    if source.num_bytes == 0:
        raise FormatError("the file is empty")
    formats: tuple[str, ...] = PHOTO_FORMATS
    try:
        with open_file(source.path) as file:
            head = file.read(12)
            if head[4:8] == b"ftyp" and head[8:] in STILL_BRANDS:  # HEIF: phones and messengers call some .jpg
                add_heif()
                formats = (*formats, "HEIF")
            with Image.open(file, formats=formats) as coded:
                check_cost(coded, file, MAX_PIXELS)
                return _from_coded(source.name, coded)
    except (FormatError, MissingExtraError):
        raise
    except UnidentifiedImageError:
        raise FormatError("it is no photo, or damaged at its beginning") from None
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"it is damaged ({error or type(error).__name__})") from error


def _from_coded(name: str, coded: Image.Image) -> tuple[Image.Image | None, str, int, Photo]:
    if min(coded.size) < MIN_SIDE_PIXELS:
        raise FormatError(f"{coded.width}x{coded.height} pixels are too few")
    exif = exif_facts(coded)
    orientation = orientation_of(coded)
    is_jpeg = coded.format in ("JPEG", "MPO")
    plain = coded.mode in ("RGB", "L") and "transparency" not in coded.info and not is_wide(coded)
    suffix = ".jpg" if is_jpeg or coded.format == "HEIF" else ".png"
    if orientation == 1 and plain and (is_jpeg or coded.format == "PNG"):
        width, height = coded.size
        coded.draft("L", (LOOK_SIDE_PIXELS, LOOK_SIDE_PIXELS))
        return None, suffix, 1, Photo(name, "", width, height, _sharpness_of(coded), exif)
    upright = ImageOps.exif_transpose(rgb_of(coded))
    exif = replace(exif, down=turned_down(exif.down, orientation))
    upright.info.clear()
    return upright, suffix, orientation, Photo(name, "", *upright.size, _sharpness_of(upright), exif)


def _sharpness_of(picture: Image.Image) -> float:
    grey = picture.convert("L")
    grey.thumbnail((LOOK_SIDE_PIXELS, LOOK_SIDE_PIXELS), Image.Resampling.BOX)
    return sharpness(np.asarray(grey))


def turned_down(down: Vector | None, orientation: int) -> Vector | None:
    """Return gravity in the axes of the upright photo; None for a mirrored photo, which no camera takes."""
    if down is None or orientation not in _TURNS:
        return None
    right, below = _TURNS[orientation]
    return right[0] * down[0] + right[1] * down[1], below[0] * down[0] + below[1] * down[1], down[2]


def add_heif() -> None:
    """Register HEIC with Pillow. Raises: MissingExtraError: pi-heif is not installed."""
    try:
        from pi_heif import register_heif_opener
    except ImportError:
        raise MissingExtraError(f"HEIC photos need pi-heif: {pip_install('capture')}") from None
    register_heif_opener()


def bring_mask(mask: Path, target: Path, size: tuple[int, int], orientation: int, invert: bool) -> bool:
    """Write a mask as 0 and 255 on the raster of its upright photo; return whether it keeps any of it.

    size: width and height of the upright photo. orientation: of the photo's EXIF; a mask of the shape of the photo as
    stored is turned with it, and one that is upright already stays.

    Raises: FormatError: no picture. MismatchError: of another shape than the photo.
    """
    picture = read_mask(mask)
    if (orientation > 4 and not same_aspect(picture.size, size)) or orientation in (2, 3, 4):
        picture.getexif()[ORIENTATION_TAG] = orientation
        picture = ImageOps.exif_transpose(picture)
    if not same_aspect(picture.size, size):
        raise MismatchError(
            f"{mask}: the mask is {picture.width}x{picture.height}, its photo {size[0]}x{size[1]}: make it of the "
            "photo as it is"
        )
    used = np.asarray(picture.resize(size, Image.Resampling.NEAREST)) >= MIN_WHITE
    pixels = np.where(used != invert, np.uint8(255), np.uint8(0))
    with replacing(target, overwrite=True) as file:
        Image.fromarray(pixels).save(file, format="PNG")
    return bool(pixels.any())
