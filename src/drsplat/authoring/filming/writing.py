"""Pictures as a film that plays: MP4 and WebM by the program ffmpeg, WebP and GIF without it.

A picture is written as it comes and forgotten. The film takes its name when it is whole.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import BinaryIO

from ...drawing.pictures import OtherPixels
from ...errors import InputError, MissingExtraError
from ...formats.replacing import refuse_missing_parent, replacing
from .encoding import SUFFIXES as ENCODED
from .encoding import encode, ffmpeg
from .gif import write_gif
from .paths import check_fps, check_size
from .webp import write_webp

Write = Callable[[BinaryIO, Iterator[OtherPixels], float], None]
PLAIN: dict[str, Write] = {".webp": write_webp, ".gif": write_gif}
SUFFIXES = (*ENCODED, *PLAIN)


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
