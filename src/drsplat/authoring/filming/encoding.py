"""MP4 and WebM through the program ffmpeg: raw pictures go to its standard input while the next is drawn."""

import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from ...base.arrays import OtherPixels
from ...base.terminal import plain
from ...errors import InputError

SUFFIXES = (".mp4", ".webm")
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
            raise InputError(f"{path}: ffmpeg failed ({_end_of(code)}): {_words(said)}")


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


def _end_of(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _words(said: IO[bytes]) -> str:
    said.seek(0, 2)
    said.seek(max(0, said.tell() - MAX_ERROR_BYTES))
    return " ".join(plain(said.read().decode(errors="replace")).split()) or "it did not say why"
