"""The folder in which a capture is made, and how it becomes the capture.

Everything is made in OUTPUT/.work, and what is done there stays when the program is stopped: photos are named after
their contents, features and matches are kept by COLMAP's database by those names. At the end the parts are moved into
place, the model last: a folder without sparse/0 is no capture, and a move that was stopped is finished by the next run.
"""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..formats.replacing import replacing

WORK, RECORD = ".work", "capture.json"
FORMAT, VERSION = "drsplat capture", 1
MODEL = "sparse"
PARTS = ("images", "masks", "georeference.json", RECORD, MODEL)
READY = "ready"


class Work:
    """Paths below OUTPUT/.work, made when the first is asked for."""

    def __init__(self, output: Path) -> None:
        self.output, self.folder = output, output / WORK
        self.photos, self.masks = self.folder / "photos", self.folder / "masks"
        self.record, self.log = self.folder / "photos.jsonl", self.folder / "colmap.log"
        self.new, self.frames = self.folder / "new", self.folder / "frames"
        self.undistorted = self.folder / "undistorted"
        self.undistorted_masks = self.undistorted / "masks"
        shutil.rmtree(self.new, ignore_errors=True)  # of a run that was stopped before it was ready
        self.photos.mkdir(parents=True, exist_ok=True)
        self.masks.mkdir(exist_ok=True)

    def remembered(self, name: str) -> Any:
        """Return a JSON document that `remember` wrote, None where there is none."""
        path = self.folder / name
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None

    def remember(self, name: str, document: Any) -> None:
        with replacing(self.folder / name, overwrite=True) as file:
            file.write(json.dumps(document).encode())


def refuse_strangers(output: Path, overwrite: bool) -> None:
    """Raises: InputError: a capture is there and may not be replaced, or files that are not ours are in its place."""
    there = [name for name in PARTS if (output / name).exists()]
    if not there or (output / WORK / READY).exists():
        return
    if not (output / RECORD).is_file():
        raise InputError(f"{output} holds {there[0]}, which drsplat capture did not make: name another output")
    if not overwrite:
        raise InputError(f"{output} exists already: pass overwrite=True to replace it, or name another output")


def refuse_overlap(photos: Path, output: Path) -> None:
    """Raises: InputError: the output is the photos' own folder, in it, or around it."""
    source, target = photos.resolve(), output.resolve()  # a video, too, is not to lie in what is made of it
    if source == target or source in target.parents or target in source.parents:
        raise InputError(f"{output}: the photos in {photos} stay as they are: name an output beside their folder")


def publish(output: Path, kept: Sequence[str] = ()) -> None:
    """Move what is ready into place; also the rest of what an earlier run began to move.

    kept: parts that stay as they are where there are no new ones; others go.
    """
    work = output / WORK
    ready = work / READY
    if not ready.exists():
        parts = [part for part in PARTS if part in kept or (work / "new" / part).exists()]
        with replacing(ready) as file:
            file.write(json.dumps(parts).encode())
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
