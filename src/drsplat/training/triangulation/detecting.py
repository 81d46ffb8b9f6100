"""SIFT on many photos. Its loops hold Python's lock, so each core needs a process of its own.

echo '[["photo.jpg", 640, 480]]' | python -m drsplat.training.triangulation.detecting > found.npz
"""

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skimage.color import rgb2gray
from skimage.feature import SIFT

from ...base.arrays import Colors, Numbers, PlanePoints, UInt8
from ...base.system import end_with
from ...errors import InputError
from ...scene.lens import undistort_points
from ...scene.photo_masks import load_mask
from ...scene.photos import load_image, photo_size
from ...scene.views import View

MIN_PHOTOS_PER_PROCESS = 8  # starting a process takes as long as a few photos
MAX_SIDE_PIXELS = 640  # more cost more, and 3DGS starts no better from them
MAX_KEYPOINTS = 1000  # of a photo, those of the largest scale first
MIN_SIDE_PIXELS = 24  # SIFT has no octave on less
MIN_CONTRAST = 0.005  # of differences of Gaussians; Lowe's 0.03 / 3 leaves a blurred phone photo without any


class Keypoints(NamedTuple):
    """Keypoints of a view: pixels on its pinhole (lens undone) at its own size, and SIFT descriptors."""

    pixels: PlanePoints
    colors: Colors
    descriptors: UInt8[np.ndarray, "n 128"]


class Detection(NamedTuple):
    """Keypoints that SIFT detected. pixels: x and y on the raster that SIFT saw; sigmas: in its pixels."""

    pixels: PlanePoints
    sigmas: Numbers
    colors: Colors
    descriptors: UInt8[np.ndarray, "n 128"]


def detect_all(stored: Sequence[View], *, threads: int = 0) -> list[Detection]:
    """Run `detect` on each view, in at most `threads` processes including this one (0: one per core).

    Raises: as `detect`. Photos of a process that fails are detected in this one.
    """
    count = max(1, min(threads or os.cpu_count() or 1, len(stored) // MIN_PHOTOS_PER_PROCESS))
    shares = [stored[begin::count] for begin in range(count)]
    with ExitStack() as stack:
        others = [stack.enter_context(_started(share)) for share in shares[1:]]
        shares_detected = [[detect(view) for view in shares[0]]]
        shares_detected += [_answer(other, share) for other, share in zip(others, shares[1:], strict=True)]
    return [shares_detected[index % count][index // count] for index in range(len(stored))]


@contextmanager
def _started(share: Sequence[View]) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a process that detects in its share; it is killed when the context ends."""
    command = [sys.executable, "-P", "-c", f"from {__name__} import main; main({os.getpid()})"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        try:
            photos = [(str(view.image_path), view.width, view.height) for view in share]
            assert process.stdin is not None
            with suppress(OSError):  # `_answer` notices a process that has ended
                process.stdin.write(json.dumps(photos).encode())
                process.stdin.close()
            yield process
        finally:
            process.kill()


def _answer(process: "subprocess.Popen[bytes]", share: Sequence[View]) -> list[Detection]:
    """Return the detections of a process; detect here if it failed."""
    assert process.stdout is not None
    output = process.stdout.read()
    if process.wait() != 0:
        return [detect(view) for view in share]
    # the detections that `_packed` packed
    with np.load(io.BytesIO(output), allow_pickle=False) as arrays:
        counts, *columns = arrays.values()
    ends = np.cumsum(counts)[:-1]
    return [Detection(*photo) for photo in zip(*(np.split(column, ends) for column in columns), strict=True)]


def _packed(detections: Sequence[Detection]) -> bytes:
    """Pack detections as the bytes of an .npz file: the counts, then each column of all photos."""
    buffer = io.BytesIO()
    counts = [len(detection.sigmas) for detection in detections]
    np.savez(buffer, counts, *(np.concatenate(columns) for columns in zip(*detections, strict=True)))
    return buffer.getvalue()


def main(parent: int | None = None) -> None:
    """Read photos as JSON, [path, width, height] each, and write their detections to stdout.

    parent: id of the process to end with, or None.
    """
    if parent is not None:
        end_with(parent)
    # poses do not matter
    views = [View(path, np.eye(3), np.eye(4), w, h, image_path=Path(path)) for path, w, h in json.load(sys.stdin)]
    sys.stdout.buffer.write(_packed([detect(view) for view in views]))


NOTHING = Detection(np.empty((0, 2)), np.empty(0, np.float32), np.empty((0, 3), np.uint8), np.empty((0, 128), np.uint8))


def located(view: View, stored: View, detection: Detection) -> Keypoints:
    """Return the keypoints detected on the photo as stored, on the pinhole of a view.

    Undoing the lens before would add the photo's border as an edge. stored: `as_stored(view)`.
    """
    scale = (view.width / stored.width, view.height / stored.height)
    pixels = undistort_points(view, detection.pixels * scale)
    usable, mask = np.isfinite(pixels).all(1), load_mask(stored)
    if mask is not None:
        x, y = np.clip(detection.pixels.astype(np.intp), 0, (stored.width - 1, stored.height - 1)).T
        usable &= mask[y, x]
    # the ascending indices of the `MAX_KEYPOINTS` usable keypoints of largest scale: these reappear most
    order = np.argsort(-detection.sigmas, kind="stable")
    chosen = np.sort(order[usable[order]][:MAX_KEYPOINTS])
    return Keypoints(pixels[chosen], detection.colors[chosen], detection.descriptors[chosen])


def detect(stored: View) -> Detection:
    """Run SIFT on the raster of `as_stored`.

    Raises: InputError, FormatError: as `load_image`.
    Source: Lowe, "Distinctive Image Features from Scale-Invariant Keypoints" (2004).
    """
    photo = load_image(stored)
    if min(photo.shape[:2]) < MIN_SIDE_PIXELS:
        return NOTHING
    sift: Any = SIFT(upsampling=1, c_dog=MIN_CONTRAST)  # type: ignore[no-untyped-call]
    try:
        with np.errstate(all="ignore"):  # a patch without gradients divides by their sum
            sift.detect_and_extract(rgb2gray(photo).astype(np.float32))
    except (RuntimeError, ValueError):  # how scikit-image says that there is no texture
        return NOTHING
    rows, columns = np.rint(sift.positions).astype(np.intp).T
    pixels = sift.positions[:, ::-1].astype(np.float64) + 0.5  # centres are at half integers
    return Detection(pixels, sift.sigmas.astype(np.float32), photo[rows, columns], sift.descriptors)


def as_stored(view: View) -> View:
    """Return the view without its lens, on the raster that SIFT sees: the photo's own, or a smaller one.

    Raises: InputError: no photo, or as `photo_size`.
    """
    if view.image_path is None:
        raise InputError(f"view '{view.name}' has no photo: read it with images=FOLDER")
    width, height = photo_size(view.image_path)
    scale = min(1.0, MAX_SIDE_PIXELS / max(width, height))
    return replace(view, distortion=None).resized(max(1, round(width * scale)), max(1, round(height * scale)))
