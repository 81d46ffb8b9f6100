"""Pictures as a film that plays: MP4 and WebM by the program ffmpeg, WebP and GIF without it.

A picture is written as it comes and forgotten. The film takes its name when it is whole.
"""

import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np
from PIL import GifImagePlugin, Image

from ...base.arrays import OtherPixels
from ...base.contents import AnyPath
from ...base.terminal import plain
from ...errors import InputError, MissingExtraError
from ...formats.replacing import refuse_missing_parent, replacing
from .paths import check_fps, check_size

ENCODED = (".mp4", ".webm")
ENCODERS = {
    ".mp4": (
        ("libx264", "-preset", "medium", "-crf", "18"), ("libopenh264", "-b:v", "8M"),
        ("h264_videotoolbox", "-q:v", "65"), ("mpeg4", "-q:v", "3"),
    ),
    ".webm": (
        ("libvpx-vp9", "-crf", "28", "-b:v", "0", "-row-mt", "1", "-deadline", "good", "-cpu-used", "4"),
        ("libvpx", "-crf", "10", "-b:v", "8M"), ("libsvtav1", "-crf", "30"),
        ("libaom-av1", "-crf", "30", "-cpu-used", "6"),
    ),
}  # fmt: skip
"""By suffix, the best first: a build of ffmpeg has some of them."""
# what players take RGB of yuv420p to be, so that colours come back as they were
COLORS = (
    "-vf", "scale=in_range=full:out_range=tv:out_color_matrix=bt709", "-pix_fmt", "yuv420p",
    "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv",
)  # fmt: skip
MAX_ERROR_BYTES = 600  # the end of ffmpeg's messages
PATIENCE_S = 600.0  # from the last picture to ffmpeg's end


def ffmpeg() -> str | None:
    """Return the path of the program ffmpeg, None where it is not installed."""
    return shutil.which("ffmpeg")


def encode(file: BinaryIO, path: Path, pictures: Iterable[OtherPixels], size: tuple[int, int], fps: float) -> None:
    """Write a film into an open file of that name, as the suffix of `path` says.

    Raises: InputError: ffmpeg fails, with its own words; it has no encoder for that.
    """
    program, suffix = ffmpeg() or "ffmpeg", path.suffix.lower()
    container = ("-movflags", "+faststart", "-f", "mp4") if suffix == ".mp4" else ("-f", suffix[1:])
    command = [
        program, "-hide_banner", "-loglevel", "error", "-nostdin", "-y",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:.6g}", "-i", "pipe:0",
        "-an", *COLORS, "-c:v", *_encoder(program, suffix), *container,
        f"file:{Path(file.name).absolute()}",
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        # in a session of its own: Ctrl-C is for us to act on, or ffmpeg would end the film early and call it whole
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said, bufsize=0, start_new_session=True
        ) as running:
            try:
                _hand_over(running.stdin, pictures)
                code = running.wait(PATIENCE_S)
            except BaseException:
                running.kill()
                raise
        if code != 0:
            end = f"signal {-code}" if code < 0 else f"exit code {code}"
            raise InputError(f"{path}: ffmpeg failed ({end}): {_words(said)}")


def _hand_over(pipe: IO[bytes] | None, pictures: Iterable[OtherPixels]) -> None:
    """Hand over all pictures, or as many as are taken: what went wrong there, the code says."""
    assert pipe is not None
    try:
        for picture in pictures:
            left = np.ascontiguousarray(picture).data.cast("B")
            while left:
                left = left[pipe.write(left) :]
        pipe.close()
    except BrokenPipeError:
        pass


def _encoder(program: str, suffix: str) -> tuple[str, ...]:
    """Return the arguments of an encoder for a suffix. Raises: InputError: this build of ffmpeg has none."""
    here = _encoders(program)
    for encoder in ENCODERS[suffix]:
        if encoder[0] in here:
            return encoder
    names = ", ".join(encoder[0] for encoder in ENCODERS[suffix])
    raise InputError(f"{program} has no encoder for {suffix} (expected one of {names}): install another, or name .webp")


@cache
def _encoders(program: str) -> frozenset[str]:
    """Return the names of the encoders that a build of ffmpeg has. Raises: InputError: it does not run."""
    command = [program, "-hide_banner", "-loglevel", "error", "-encoders"]
    try:
        listed = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        raise InputError(f"{program} does not run: {error}") from error
    lines = (line.split() for line in listed.stdout.decode(errors="replace").splitlines())
    return frozenset(parts[1] for parts in lines if len(parts) > 1)


def _words(said: IO[bytes]) -> str:
    said.seek(0, 2)
    said.seek(max(0, said.tell() - MAX_ERROR_BYTES))
    return " ".join(plain(said.read().decode(errors="replace")).split()) or "it did not say why"


Write = Callable[[BinaryIO, Iterator[OtherPixels], float], None]
PALETTE_COLORS = 256
LOOP = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"  # without end
MAX_FPS = 50.0  # browsers play frames shorter than two hundredths of a second at ten a second
QUALITY = 80
METHOD = 2
ANIMATED_FLAG = 0x02  # in VP8X
MAX_FILE_BYTES = (1 << 32) - 16  # a RIFF's limit
BITSTREAMS = (b"VP8 ", b"VP8L")
NO_BLENDING_FLAG = 0x02  # in ANMF: a frame replaces the one before


def write_film(path: AnyPath, pictures: Iterable[OtherPixels], fps: float, overwrite: bool = False) -> None:
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


def check_film(path: AnyPath, size: tuple[int, int], fps: float) -> None:
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
        image = Image.fromarray(picture).quantize(PALETTE_COLORS, method=Image.Quantize.FASTOCTREE)
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
