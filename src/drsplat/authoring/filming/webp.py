"""Animated WebP, a picture at a time: Pillow makes the pictures, and would hold all of them to join them.

Source: WebP Container Specification (RIFF, VP8X, ANIM, ANMF), developers.google.com/speed/webp/docs/riff_container.
"""

import io
from collections.abc import Iterator
from typing import BinaryIO

from PIL import Image

from ...drawing.pictures import OtherPixels
from ...errors import InputError

QUALITY = 80
METHOD = 2
ANIMATED_FLAG = 0x02  # in VP8X
MAX_FILE_BYTES = (1 << 32) - 16  # a RIFF's limit
BITSTREAMS = (b"VP8 ", b"VP8L")
NO_BLENDING_FLAG = 0x02  # in ANMF: a frame replaces the one before


def write_webp(file: BinaryIO, pictures: Iterator[OtherPixels], fps: float) -> None:
    """Write an endless loop. Raises: InputError: more than 4 GB."""
    done, size = 0, (0, 0)
    file.write(bytes(12))
    for done, picture in enumerate(pictures, 1):
        if done == 1:
            size = (picture.shape[1], picture.shape[0])
            file.write(_chunk(b"VP8X", bytes([ANIMATED_FLAG, 0, 0, 0]) + _three(size[0] - 1) + _three(size[1] - 1)))
            file.write(_chunk(b"ANIM", bytes(4) + (0).to_bytes(2, "little")))
        lasts = round(1000 * done / fps) - round(1000 * (done - 1) / fps)
        frame = bytes(6) + _three(size[0] - 1) + _three(size[1] - 1) + _three(max(1, lasts)) + bytes([NO_BLENDING_FLAG])
        file.write(_chunk(b"ANMF", frame + _bitstream(picture)))
        if file.tell() > MAX_FILE_BYTES:
            raise InputError("a WebP holds 4 GB, and this film is larger: name it .mp4, or make it shorter or smaller")
    length = file.tell()
    file.seek(0)
    file.write(b"RIFF" + (length - 8).to_bytes(4, "little") + b"WEBP")
    file.seek(0, 2)


def _bitstream(picture: OtherPixels) -> bytes:
    """Return the chunk of a still WebP that holds its pixels."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "WEBP", quality=QUALITY, method=METHOD)
    data, at = out.getvalue(), 12
    while at + 8 <= len(data):
        length = 8 + int.from_bytes(data[at + 4 : at + 8], "little")
        if data[at : at + 4] in BITSTREAMS:
            return data[at : at + length + length % 2]
        at += length + length % 2
    raise InputError("Pillow wrote a WebP without pixels: install another Pillow, or name the film .gif")


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + len(data).to_bytes(4, "little") + data + bytes(len(data) % 2)


def _three(number: int) -> bytes:
    return number.to_bytes(3, "little")
