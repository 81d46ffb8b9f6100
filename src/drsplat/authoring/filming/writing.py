"""Pictures as a film that plays: MP4 and WebM by the program ffmpeg, WebP and GIF without it.

A picture is written as it comes and forgotten. The film takes its name when it is whole.

Source: GIF89a specification, with Netscape's application extension for the loop; WebP Container Specification (RIFF,
VP8X, ANIM, ANMF), developers.google.com/speed/webp/docs/riff_container.
"""

import io
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import BinaryIO

from PIL import GifImagePlugin, Image

from ...base.arrays import OtherPixels
from ...errors import InputError, MissingExtraError
from ...formats.replacing import refuse_missing_parent, replacing
from .encoding import SUFFIXES as ENCODED
from .encoding import encode, ffmpeg
from .paths import check_fps, check_size

Write = Callable[[BinaryIO, Iterator[OtherPixels], float], None]
COLORS = 256
LOOP = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"  # without end
MAX_FPS = 50.0  # browsers play frames shorter than two hundredths of a second at ten a second
QUALITY = 80
METHOD = 2
ANIMATED_FLAG = 0x02  # in VP8X
MAX_FILE_BYTES = (1 << 32) - 16  # a RIFF's limit
BITSTREAMS = (b"VP8 ", b"VP8L")
NO_BLENDING_FLAG = 0x02  # in ANMF: a frame replaces the one before


def write_film(path: str | PathLike[str], pictures: Iterable[OtherPixels], fps: float, overwrite: bool = False) -> None:
    """Write pictures of one size, so many a second, as what the name ends in: .mp4, .webm, .webp or .gif.

    Raises: InputError: as `check_film`; no picture; pictures of different sizes; ffmpeg fails. MissingExtraError:
    there is no ffmpeg.
    """
    path, coming = Path(path), iter(pictures)
    first = next(coming, None)
    if first is None:
        raise InputError(f"{path}: there is no picture to write")
    check_film(path, (first.shape[1], first.shape[0]), fps)
    alike = _alike(chain([first], coming), first.shape)
    with replacing(path, overwrite) as file:
        if path.suffix.lower() in ENCODED:
            encode(file, path, alike, (first.shape[1], first.shape[0]), fps)
        else:
            PLAIN[path.suffix.lower()](file, alike, fps)


def check_film(path: str | PathLike[str], size: tuple[int, int], fps: float) -> None:
    """Check all that can be known to be wrong before the first picture. size: width and height.

    Raises: InputError: another suffix, a size that the suffix cannot have, as `check_fps`, no folder.
    MissingExtraError: there is no ffmpeg.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: films are written as {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    check_size(size)
    check_fps(fps)
    refuse_missing_parent(path)
    if suffix not in ENCODED:
        return
    if size[0] % 2 or size[1] % 2:
        raise InputError(f"size: {suffix} needs an even width and height, got {size[0]}x{size[1]}: name one, or .webp")
    if ffmpeg() is None:
        raise MissingExtraError(
            f"{path}: {suffix} is written by the program ffmpeg, which is not here: install it, or name a film .webp"
        )


def _alike(pictures: Iterable[OtherPixels], shape: tuple[int, ...]) -> Iterator[OtherPixels]:
    for picture in pictures:
        if picture.shape != shape:
            raise InputError(f"expected pictures of one size, got {shape[1::-1]} and {picture.shape[1::-1]}")
        yield picture


def write_gif(file: BinaryIO, pictures: Iterator[OtherPixels], fps: float) -> None:
    """Write an endless loop of 50 pictures a second at most: GIF counts time in hundredths of a second."""
    for number, picture in enumerate(pictures):
        image = Image.fromarray(picture).quantize(COLORS, method=Image.Quantize.FASTOCTREE)
        if number == 0:
            width, height = (side.to_bytes(2, "little") for side in image.size)
            file.write(b"GIF89a" + width + height + bytes([0x70, 0, 0]) + LOOP)
        rate = min(fps, MAX_FPS)
        lasts = round(100 * (number + 1) / rate) - round(100 * number / rate)
        for part in GifImagePlugin.getdata(image, duration=10 * lasts, include_color_table=True):
            file.write(part)
    file.write(b";")


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


PLAIN: dict[str, Write] = {".webp": write_webp, ".gif": write_gif}
SUFFIXES = (*ENCODED, *PLAIN)
