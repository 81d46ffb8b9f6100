"""Cost of decoding a picture file, from its headers, before a decoder is started.

A file of some hundred bytes can declare gigabytes, and a progressive JPEG can send its pixels over again as often as
it has bytes for.
"""

import re
from io import BufferedIOBase

from PIL import Image
from PIL.BmpImagePlugin import BmpImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.TiffImagePlugin import TiffImageFile

from ..errors import InputError

MAX_SCANS_OF_LARGE = 32  # JPEGs; encoders write 1 to 15
MAX_SCANS_OF_SMALL = 500
SMALL_PIXELS = 1 << 20
MAX_JPEG_BYTES = 256 << 20

_MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])", re.DOTALL)  # not stuffing or restarts, which stand among pixels
_START_MARKER = 0xD8
_SCAN_MARKER = 0xDA
_END_MARKER = 0xD9
_TILE_WIDTH_TAG, _TILE_LENGTH_TAG = 322, 323


def check_cost(picture: Image.Image, file: BufferedIOBase, most_pixels: int | None = None) -> None:
    """Refuse a picture that takes more time or memory to decode than its pixels deserve.

    picture: opened, not decoded. file: what it was opened from; its position stays.

    Raises: InputError: more pixels than `most_pixels`, a JPEG of too many scans, a TIFF of tiles far larger than
    itself, a BMP of runs, which is decoded byte by byte in Python and in older Pillow believes their lengths.
    """
    pixels, size = picture.width * picture.height, f"{picture.width}x{picture.height}"
    if most_pixels is not None and pixels > most_pixels:
        raise InputError(f"a picture of {size} pixels: at most {most_pixels:,} are taken, make it smaller")
    if isinstance(picture, JpegImageFile):
        scans, most = jpeg_scans(_content(file)), most_scans(pixels)
        if scans > most:
            raise InputError(f"a JPEG of {size} pixels in {scans} scans: at most {most} are taken, save it anew")
    if isinstance(picture, TiffImageFile) and _tile(picture) > 4 * max(pixels, SMALL_PIXELS):
        raise InputError(f"a TIFF of {size} pixels in far larger tiles: save it as PNG")
    if isinstance(picture, BmpImageFile) and picture.info.get("compression") in (1, 2):
        raise InputError("a BMP of runs of pixels (RLE): save it as PNG")


def most_scans(pixels: int) -> int:
    """Return the number of scans a JPEG may have, so that their total number of pixels is bounded."""
    return min(MAX_SCANS_OF_SMALL, MAX_SCANS_OF_LARGE * max(1, SMALL_PIXELS // max(pixels, 1)))


def jpeg_scans(data: bytes) -> int:
    """Count the scans of a JPEG: its SOS markers, except those of previews inside segments."""
    scans, at = 0, 0
    while match := _MARKER.search(data, at):
        marker, at = match[1][0], match.end()
        if marker == _END_MARKER:
            break
        scans += marker == _SCAN_MARKER
        if marker != _START_MARKER:
            at += int.from_bytes(data[at : at + 2], "big")
    return scans


def _content(file: BufferedIOBase) -> bytes:
    position = file.tell()
    file.seek(0)
    content = file.read(MAX_JPEG_BYTES + 1)
    file.seek(position)
    if len(content) > MAX_JPEG_BYTES:
        raise InputError(f"a JPEG of more than {MAX_JPEG_BYTES:,} bytes")
    return content


def _tile(picture: TiffImageFile) -> int:
    tags = picture.tag_v2
    return int(tags.get(_TILE_WIDTH_TAG, 0)) * int(tags.get(_TILE_LENGTH_TAG, 0))
