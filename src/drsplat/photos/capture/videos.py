"""Frames of a video as photos. FFmpeg's libraries, by PyAV, decode it twice: to measure, and to write."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...base.contents import open_file
from ...errors import InputError, MissingExtraError
from ...formats.replacing import replacing
from .finding import VIDEO_ENDS, Source
from .frames import Choice, Film, choose, movement
from .photos import INSTALL, JPEG_QUALITY, MAX_PIXELS, sharpness
from .posing import Progress
from .work import Work

LOOK_WIDTH_PIXELS = 256  # of the small frames that are measured
MAX_FRAMES = 500_000
RECORD = "frames.json"


def is_video(path: Path) -> bool:
    """Return whether a path is named like a video."""
    return path.is_file() and path.suffix.lower() in VIDEO_ENDS


def video_source(path: Path) -> Source:
    """Return the video as a source."""
    stat = path.stat()
    return Source(path.name, path, stat.st_size, stat.st_mtime_ns)


def take_frames(video: Source, work: Work, progress: Progress) -> dict[str, int]:
    """Write the chosen frames into the work folder, and return the numbers of frames, chosen and left out.

    Frames that an earlier run has written are kept.

    Raises: InputError: no video, no pictures in it, or a camera that stands still. MissingExtraError: PyAV is missing.
    """
    key = [video.name, video.num_bytes, video.changed_ns]
    earlier = work.remembered(RECORD)
    if earlier is not None and earlier["video"] == key:
        counts: dict[str, int] = earlier["counts"]
        return counts
    film = _measured(video.path, progress)
    choice = choose(film)
    if len(choice.frames) < 3:
        raise InputError(_hardly_any(video.path, film, choice))
    _write(video.path, choice, work.frames, progress)
    counts = {
        "num_frames": len(film.moved),
        "num_blurred": choice.num_blurred,
        "num_still": choice.num_still,
        "num_chosen": len(choice.frames),
    }
    work.remember(RECORD, {"video": key, "counts": counts})
    return counts


def _hardly_any(video: Path, film: Film, choice: Choice) -> str:
    frames = f"{len(film.moved)} frames, {choice.num_blurred} of them blurred"
    return f"{video}: the camera hardly moves ({frames}): walk with it round what you film"


def _measured(video: Path, progress: Progress) -> Film:
    """Measure the sharpness and movement of each frame."""
    sharp: list[float] = []
    moved: list[float] = []
    before = None
    with _opened(video) as (container, stream):
        total = stream.frames or 0
        for frame in _decoded(container, stream, video):
            height = max(64, round(LOOK_WIDTH_PIXELS * frame.height / frame.width))
            small = frame.reformat(
                width=LOOK_WIDTH_PIXELS, height=min(height, 4 * LOOK_WIDTH_PIXELS), format="gray"
            ).to_ndarray()
            sharp.append(sharpness(small))
            moved.append(0.0 if before is None else movement(before, small))
            before = small
            progress("frames", len(moved), max(total, len(moved)))
    if not moved:
        raise InputError(f"{video}: there is no picture in it that can be read")
    return Film(np.array(sharp), np.array(moved))


def _write(video: Path, choice: Choice, folder: Path, progress: Progress) -> None:
    """Write the chosen frames as JPEG files with numbered names, upright."""
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    wanted = iter(choice.frames.tolist())
    number, written = next(wanted), 0
    with _opened(video) as (container, stream):
        for index, frame in enumerate(_decoded(container, stream, video)):
            if index < number:
                continue
            picture = Image.fromarray(frame.to_ndarray(format="rgb24"))
            turned = picture.rotate(int(getattr(frame, "rotation", 0)), expand=True)
            with replacing(folder / f"frame_{index:06}.jpg") as file:
                turned.save(file, format="JPEG", quality=JPEG_QUALITY, subsampling=0)
            written += 1
            progress("photos of it", written, len(choice.frames))
            number = next(wanted, -1)
            if number < 0:
                return


@contextmanager
def _opened(video: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video's first stream of pictures. Raises: InputError: there is none; MissingExtraError; as `open_file`."""
    try:
        import av
    except ImportError:
        raise MissingExtraError(f"videos need PyAV: {INSTALL}") from None
    av.logging.set_level(av.logging.PANIC)
    try:
        with open_file(video), av.open(str(video)) as container:
            if not container.streams.video:
                raise InputError(f"{video}: there are no pictures in it, sound alone: name a film")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            if stream.width * stream.height > MAX_PIXELS:
                raise InputError(f"{video}: its frames of {stream.width}x{stream.height} pixels are too large")
            yield container, stream
    except av.FFmpegError as error:
        raise InputError(
            f"{video}: cannot be read as a video: it is empty, damaged or cut off, or of another kind "
            f"({error.strerror or error})"
        ) from error


def _decoded(container: Any, stream: Any, video: Path) -> Iterator[Any]:
    """Yield the frames up to the first damaged one."""
    import av

    try:
        for index, frame in enumerate(container.decode(stream)):
            if index >= MAX_FRAMES:
                raise InputError(f"{video}: expected at most {MAX_FRAMES:,} frames: cut it")
            yield frame
    except av.FFmpegError:
        return
