"""Facts in a photo's EXIF: its camera, its place on the Earth and how it was held.

Source: CIPA DC-008 (Exif 2.32) for the tags; ExifTool's documentation of Apple's maker notes for the acceleration.
"""

import math
import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from PIL import Image

MAKE_TAG, MODEL_TAG = 271, 272
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
    return ExifFacts(
        camera=" ".join(part for part in camera if part),
        focal_share=_focal_share(tags),
        position=_position(gps),
        down=_apple_down(tags.get(MAKER_NOTE_TAG)),
    )


def _focal_share(tags: dict[int, Any]) -> float | None:
    share = _number(tags.get(FOCAL_35MM_TAG)) / DIAGONAL_35MM_FILM_MM
    return share if FOCAL_SHARE_BOUNDS[0] <= share <= FOCAL_SHARE_BOUNDS[1] else None


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
