"""Frames of a video as photos. FFmpeg's libraries, by PyAV, decode it twice: to measure, and to write.

Frames that become photos are sharp ones, each after the picture has moved on. Time plays no part: a camera that stands
still gives one photo, one that turns quickly gives many.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

from ...base.arrays import Doubles, GreyPixels, Indices, OtherPixels
from ...base.contents import open_file
from ...errors import InputError, MissingExtraError, pip_install
from ...formats.replacing import replacing
from .finding import VIDEO_ENDS, Source
from .photos import JPEG_QUALITY, MAX_PIXELS, sharpness
from .posing import Progress
from .work import Work

LOOK_WIDTH_PIXELS = 256  # of the small frames that are measured
MAX_FRAMES = 500_000
RECORD = "frames.json"
STEP_SHARE = 0.06  # of the picture's width, from one photo to the next
TARGET_PHOTOS_BOUNDS = (40, 1000)  # the step is made shorter or longer to reach this range
MIN_STEP_SHARE = 0.01
MAX_STILL_SHARE = 0.001  # of the width moved since the frame before: it shows the same picture again
MAX_BLURRED_SHARE = 0.6  # of the median sharpness of the frames around
NEIGHBOURHOOD_FRAMES = 15  # to either side
BLOCKS_ACROSS = 4


class Film(NamedTuple):
    """Measurements of each frame. sharpness: see `photos.sharpness`. moved: shares of the width since the last."""

    sharpness: Doubles
    moved: Doubles


class Choice(NamedTuple):
    """Choice of frames. frames: indices of the chosen ones. num_blurred, num_still: of unusable ones."""

    frames: Indices
    num_blurred: int
    num_still: int


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
        return earlier["counts"]
    film = _measured(video.path, progress)
    frames, num_blurred, num_still = choose(film)
    num_frames = len(film.moved)
    if len(frames) < 3:
        raise InputError(
            f"{video.path}: the camera hardly moves ({num_frames} frames, {num_blurred} of them blurred): walk with it "
            "round what you film"
        )
    _write(video.path, frames.tolist(), work.frames, progress)
    counts = {
        "num_frames": num_frames, "num_blurred": num_blurred, "num_still": num_still, "num_chosen": len(frames),
    }  # fmt: skip
    work.remember(RECORD, {"video": key, "counts": counts})
    return counts


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


def _write(video: Path, numbers: list[int], folder: Path, progress: Progress) -> None:
    """Write the frames of these numbers, ascending, as JPEG files with numbered names, upright."""
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    written = 0
    with _opened(video) as (container, stream):
        for index, frame in enumerate(islice(_decoded(container, stream, video), numbers[-1] + 1)):
            if index != numbers[written]:
                continue
            picture = Image.fromarray(frame.to_ndarray(format="rgb24"))
            turned = picture.rotate(int(getattr(frame, "rotation", 0)), expand=True)
            with replacing(folder / f"frame_{index:06}.jpg") as file:
                turned.save(file, format="JPEG", quality=JPEG_QUALITY, subsampling=0)
            written += 1
            progress("photos of it", written, len(numbers))


def some_frames(video: Path, count: int) -> Iterator[OtherPixels]:
    """Yield frames of a video, evenly spaced in time, as they are stored; fewer where it cannot be searched.

    Raises: InputError: no video, or no pictures in it. MissingExtraError: PyAV is missing.
    """
    with _opened(video) as (container, stream):
        for number in range(count):
            container.seek(int((container.duration or 0) * (number + 0.5) / count))
            frame = next(_decoded(container, stream, video), None)
            if frame is not None:
                yield frame.to_ndarray(format="rgb24")


@contextmanager
def _opened(video: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video's first stream of pictures. Raises: InputError: there is none; MissingExtraError; as `open_file`."""
    try:
        import av
    except ImportError:
        raise MissingExtraError(f"videos need PyAV: {pip_install('capture')}") from None
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


def choose(film: Film) -> Choice:
    """Choose the sharpest frame of each step of the picture's movement; steps without a sharp frame give none."""
    path, size = np.cumsum(film.moved), 2 * NEIGHBOURHOOD_FRAMES + 1
    usual = ndimage.median_filter(film.sharpness, size=size, mode="nearest")  # of the frames around
    blurred = film.sharpness < MAX_BLURRED_SHARE * usual
    usable = np.flatnonzero(~blurred)
    if not len(usable):
        return Choice(usable, int(blurred.sum()), 0)
    fewest, most = TARGET_PHOTOS_BOUNDS
    step = float(np.clip(path[-1] / fewest, MIN_STEP_SHARE, max(STEP_SHARE, path[-1] / most)))
    steps = np.round(path[usable] / step).astype(np.int64)
    order = np.lexsort((usable, -film.sharpness[usable], steps))
    first = np.unique(steps[order], return_index=True)[1]
    still = int((film.moved[1:] < MAX_STILL_SHARE).sum())
    return Choice(np.sort(usable[order[first]]), int(blurred.sum()), still)


def movement(before: GreyPixels, now: GreyPixels) -> float:
    """Return how far parts of a picture have moved, as the median share of its width.

    It is measured by blocks, because a camera that walks ahead or rolls moves them in different directions.
    """
    side = now.shape[1] // BLOCKS_ACROSS
    shifts = [
        shift_of(before[y : y + side, x : x + side], now[y : y + side, x : x + side])
        for y in range(0, now.shape[0] - side + 1, side)
        for x in range(0, now.shape[1] - side + 1, side)
    ]
    return float(np.median(shifts)) / now.shape[1] if shifts else 0.0


def shift_of(before: GreyPixels, now: GreyPixels) -> float:
    """Return the length of a block's shift in pixels, by phase correlation; 0 if it has no texture.

    Source: Kuglin and Hines, The phase correlation image alignment method, 1975.
    """
    height, width = now.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    spectrum, shifted = (np.fft.rfft2((block - block.mean()) * window) for block in (before, now))
    cross = spectrum * shifted.conj()
    strength = np.abs(cross)
    if not strength.max() > 1e-6:
        return 0.0
    peak = np.fft.irfft2(cross / np.maximum(strength, 1e-3 * strength.max()), s=(height, width)).argmax()
    down, across = divmod(int(peak), width)
    down, across = min(down, height - down), min(across, width - across)
    return float(np.hypot(down, across))
