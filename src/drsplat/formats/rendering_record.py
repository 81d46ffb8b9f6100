"""photograph.json: that the pictures of a capture are renderings, of which scene, and how they were made.

format, version   "drsplat photograph", 1
drsplat           the version that rendered them
scene             name of the file, fingerprint and checksum of its Gaussians, their number, antialiased
time              of a moving scene, else null
settings          what was asked for
num_pictures      how many there are
coverage          what they show of the scene
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..scene.views import View
from .json_files import as_document, as_fields, as_kind, read_json, write_json
from .photo_files import capture_folder
from .tensors import check_seal, sealed

RECORD = "photograph.json"
FORMAT, VERSION = "drsplat photograph", 1
CURE = "Make the pictures again with `drsplat photograph`"


def write_rendering_record(folder: Path, record: Mapping[str, object]) -> None:
    """Write the record of a folder. Raises: InputError: there is one, or the disk is full."""
    write_json(folder / RECORD, sealed({"format": FORMAT, "version": VERSION, **record}))


def read_rendering_record(folder: Path) -> dict[str, object] | None:
    """Return the record of a capture's folder, or None where its pictures are photos.

    Raises: FormatError: damaged, edited, or of another version.
    """
    path = folder / RECORD
    if not path.is_file():
        return None
    record = as_document(read_json(path), str(path), FORMAT, VERSION)
    check_seal(record, f"{path}", cure=CURE)
    return record


def rendered_from(record: Mapping[str, object], where: str) -> str:
    """Return the scene of a record, its name and fingerprint. Raises: FormatError: there is none."""
    name, fingerprint = as_fields(record.get("scene"), f"{where}: scene", name=str, fingerprint=str).values()
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
    source, time = rendered_from(record, where), as_kind(record.get("time"), float | None, f"{where}: time")
    return [replace(view, rendered_from=source, time=view.time if time is None else time) for view in views]
