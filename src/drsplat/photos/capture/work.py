"""The folder in which a capture is made, and how it becomes the capture.

Everything is made in OUTPUT/.work and stays there when the program is stopped: photos are named after
their contents, and COLMAP's database keeps features and matches under those names. At the end the parts are moved into
place, the model last: a folder without sparse/0 is no capture, and the next run finishes a move that was stopped.
"""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...formats.json_files import write_json

WORK, RECORD = ".work", "capture.json"
FORMAT, VERSION = "drsplat capture", 1
MODEL = "sparse"
PARTS = ("images", "masks", "georeference.json", RECORD, MODEL)
READY = "ready"


class Work:
    """Paths below OUTPUT/.work, and that folder itself."""

    def __init__(self, output: Path) -> None:
        self.output, self.folder = output, output / WORK
        self.photos, self.masks = self.folder / "photos", self.folder / "masks"
        self.record, self.log = self.folder / "photos.jsonl", self.folder / "colmap.log"
        self.new, self.frames = self.folder / "new", self.folder / "frames"
        self.undistorted = self.folder / "undistorted"
        shutil.rmtree(self.new, ignore_errors=True)  # of a run that was stopped before it was ready
        self.photos.mkdir(parents=True, exist_ok=True)
        self.masks.mkdir(exist_ok=True)

    def remembered(self, name: str) -> Any:
        """Read a JSON document that `remember` wrote; None if there is none."""
        path = self.folder / name
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None

    def remember(self, name: str, document: Any) -> None:
        """Write a JSON document for later runs."""
        write_json(self.folder / name, document, overwrite=True)


def refuse_strangers(output: Path, overwrite: bool) -> None:
    """Check the output folder for another capture or other files.

    Raises: InputError: a capture exists and may not be replaced, or files of others are in its place.
    """
    present = [name for name in PARTS if (output / name).exists()]
    if not present or (output / WORK / READY).exists():
        return
    if not (output / RECORD).is_file():
        raise InputError(f"{output} holds {present[0]}, which drsplat capture did not make: name another output")
    if not overwrite:
        raise InputError(f"{output} exists already: pass overwrite=True to replace it, or name another output")


def refuse_overlap(photos: Path, output: Path) -> None:
    """Check the output against the input. Raises: InputError: one is the other, or in it."""
    source, target = photos.resolve(), output.resolve()  # a video must not lie in its capture, either
    if source == target or source in target.parents or target in source.parents:
        raise InputError(f"{output}: the photos in {photos} stay as they are: name an output beside their folder")


def publish(output: Path, unchanged: Sequence[str] = ()) -> None:
    """Move finished parts into place, or finish what an earlier run began to move.

    unchanged: parts that stay where there are no new ones; others are removed.
    """
    work = output / WORK
    ready = work / READY
    if not ready.exists():
        write_json(ready, [part for part in PARTS if part in unchanged or (work / "new" / part).exists()])
    parts = json.loads(ready.read_text(encoding="utf-8"))
    if (work / "new" / MODEL).exists():
        _remove(output / MODEL)  # from here on there is no capture, until the new model comes last
    for part in PARTS:
        new, place = work / "new" / part, output / part
        if new.exists() or part not in parts:
            _remove(place)
        if new.exists():
            new.replace(place)
    shutil.rmtree(work)


def is_ready(output: Path) -> bool:
    """Return whether an earlier run was stopped while it moved the capture into place."""
    return (output / WORK / READY).exists()


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
