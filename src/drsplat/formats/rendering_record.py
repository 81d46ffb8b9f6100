"""photograph.json: that the pictures of a capture are renderings, of which scene, and how they were made.

format, version   "drsplat photograph", 1
drsplat           the version that rendered them
scene             name of the file, fingerprint and checksum of its Gaussians, their number, antialiased
time              of a moving scene, else null
settings          what was asked for
num_pictures      how many there are
coverage          what they show of the scene
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..errors import FormatError
from ..scene.views import View
from .checksums import check_seal, sealed
from .json_files import excerpt, is_text, read_json
from .photo_files import capture_folder
from .replacing import replacing

RECORD = "photograph.json"
FORMAT, VERSION = "drsplat photograph", 1
CURE = "Make the pictures again with `drsplat photograph`"


def write_rendering_record(folder: Path, record: Mapping[str, object]) -> None:
    """Write the record of a folder. Raises: InputError: there is one, or the disk is full."""
    document = sealed({"format": FORMAT, "version": VERSION, **record})
    with replacing(folder / RECORD) as file:
        file.write((json.dumps(document, indent=1) + "\n").encode())


def read_rendering_record(folder: Path) -> dict[str, object] | None:
    """Return the record of a capture's folder, or None where its pictures are photos.

    Raises: FormatError: damaged, edited, or of another version.
    """
    path = folder / RECORD
    if not path.is_file():
        return None
    record = read_json(path)
    if not isinstance(record, dict) or (record.get("format"), record.get("version")) != (FORMAT, VERSION):
        raise FormatError(f"{path}: expected the record of rendered pictures, version {VERSION}")
    check_seal(record, f"{path}", cure=CURE)
    return record


def rendered_from(record: Mapping[str, object], where: str) -> str:
    """Return the scene of a record, its name and fingerprint. Raises: FormatError: there is none."""
    scene = record.get("scene")
    name, fingerprint = (scene.get(key) for key in ("name", "fingerprint")) if isinstance(scene, dict) else (None, None)
    if not is_text(name) or not is_text(fingerprint):
        raise FormatError(f"{where}: expected the scene's name and fingerprint, got {excerpt(scene)}. {CURE}")
    return f"{name} ({fingerprint})"


def with_renderings(views: list[View], capture: Path) -> list[View]:
    """Return the views of a capture marked as renderings, and with the time of a moving scene, where a record says so.

    capture: its folder, its model's folder or one of its files.

    Raises: FormatError: a damaged record.
    """
    folder = capture_folder(capture)
    record = read_rendering_record(folder)
    if record is None:
        return views
    where = str(folder / RECORD)
    source, time = rendered_from(record, where), record.get("time")
    if not (time is None or isinstance(time, float)):
        raise FormatError(f"{where}: time: expected a number or null, got {excerpt(time)}. {CURE}")
    return [replace(view, rendered_from=source, time=view.time if time is None else time) for view in views]
