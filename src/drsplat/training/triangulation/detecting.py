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
from pathlib import Path

import numpy as np

from ...base.system import end_with
from ...scene.views import View
from .keypoints import Detection, detect

MIN_PHOTOS_PER_PROCESS = 8  # starting a process takes as long as a few photos


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
    return _unpacked(output)


def _packed(detections: Sequence[Detection]) -> bytes:
    """Pack detections as the bytes of an .npz file: the counts, then each column of all photos."""
    buffer = io.BytesIO()
    counts = [len(detection.sigmas) for detection in detections]
    np.savez(buffer, counts, *(np.concatenate(columns) for columns in zip(*detections, strict=True)))
    return buffer.getvalue()


def _unpacked(packed: bytes) -> list[Detection]:
    """Return the detections that `_packed` packed."""
    with np.load(io.BytesIO(packed), allow_pickle=False) as arrays:
        counts, *columns = arrays.values()
    ends = np.cumsum(counts)[:-1]
    return [Detection(*photo) for photo in zip(*(np.split(column, ends) for column in columns), strict=True)]


def _view(path: str, width: int, height: int) -> View:
    """Return a view of the photo with an identity pose; detection needs no other."""
    return View(path, np.eye(3), np.eye(4), width, height, image_path=Path(path))


def main(parent: int | None = None) -> None:
    """Read photos as JSON, [path, width, height] each, and write their detections to stdout.

    parent: id of the process to end with, or None.
    """
    if parent is not None:
        end_with(parent)
    photos = json.load(sys.stdin)
    sys.stdout.buffer.write(_packed([detect(_view(*photo)) for photo in photos]))
