"""SIFT on many photos: its loops hold Python's lock, so that each core needs a process of its own.

echo '[["photo.jpg", 640, 480]]' | python -m drsplat.triangulation.detecting > found.npz
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

from ..scene.views import View
from ..system import end_with
from .keypoints import Detection, detect

LEAST_PHOTOS = 8  # of a process: to start it takes as long as a few of them


def detect_all(stored: Sequence[View], *, threads: int = 0) -> list[Detection]:
    """`detect` on each of them, in at most `threads` processes (0: one for each core), of which this is one.

    Raises: as `detect`: what another process does not answer is found, or fails, in this one.
    """
    count = max(1, min(threads or os.cpu_count() or 1, len(stored) // LEAST_PHOTOS))
    shares = [stored[begin::count] for begin in range(count)]
    with ExitStack() as stack:
        others = [stack.enter_context(_started(share)) for share in shares[1:]]
        found = [[detect(view) for view in shares[0]]]
        found += [_answer(other, share) for other, share in zip(others, shares[1:], strict=True)]
    return [found[index % count][index // count] for index in range(len(stored))]


@contextmanager
def _started(share: Sequence[View]) -> Iterator["subprocess.Popen[bytes]"]:
    """Another process at work on its share; it is ended with the context."""
    command = [sys.executable, "-P", "-c", f"from {__name__} import main; main({os.getpid()})"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        try:
            asked = [(str(view.image_path), view.width, view.height) for view in share]
            assert process.stdin is not None
            with suppress(OSError):  # one that has ended is found out when it is to answer
                process.stdin.write(json.dumps(asked).encode())
                process.stdin.close()
            yield process
        finally:
            process.kill()


def _answer(process: "subprocess.Popen[bytes]", share: Sequence[View]) -> list[Detection]:
    assert process.stdout is not None
    said = process.stdout.read()
    if process.wait() != 0:
        return [detect(view) for view in share]
    return _unpacked(said)


def _packed(found: Sequence[Detection]) -> bytes:
    buffer = io.BytesIO()
    counts = [len(one.sigmas) for one in found]
    np.savez(buffer, counts, *(np.concatenate(columns) for columns in zip(*found, strict=True)))
    return buffer.getvalue()


def _unpacked(said: bytes) -> list[Detection]:
    with np.load(io.BytesIO(said), allow_pickle=False) as arrays:
        counts, *columns = arrays.values()
    ends = np.cumsum(counts)[:-1]
    return [Detection(*one) for one in zip(*(np.split(column, ends) for column in columns), strict=True)]


def _view(path: str, width: int, height: int) -> View:
    """Of a photo, from anywhere."""
    return View(path, np.eye(3), np.eye(4), width, height, image_path=Path(path))


def main(parent: int | None = None) -> None:
    """Detect in the photos that come in as JSON, [path, width, height] each, and write their detections to stdout.

    parent: the process to end with, if there is one.
    """
    if parent is not None:
        end_with(parent)
    asked = json.load(sys.stdin)
    sys.stdout.buffer.write(_packed([detect(_view(*photo)) for photo in asked]))
