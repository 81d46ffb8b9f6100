"""scan.json: what a folder was scanned from, with which options, and which stages are done.

format, version   "drsplat scan", 1
input             path, kind (photos, video or capture) and fingerprint
capture           folder of the posed photos, absolute or inside the scan's folder
models            segmenter and encoder that embedded the photos
stages            by name: options, whether it is done, its seconds and what it answered
"""

from pathlib import Path
from typing import NamedTuple

from ..base.contents import Document
from .json_files import as_document, as_fields, read_json, write_json

RECORD = "scan.json"
FORMAT, VERSION = "drsplat scan", 1
MODEL, CAPTURE = "model", "capture"


class _Stage(NamedTuple):
    options: object


_PARTS = {"input": dict[str, object], "capture": str, "models": dict[str, object], "stages": dict[str, _Stage]}


def read_scan_record(folder: Path) -> Document | None:
    """Return the record of a scanned folder, None where there is none.

    Raises: FormatError: damaged, or of a later version.
    """
    path = folder / RECORD
    if not path.is_file():
        return None
    record = as_document(read_json(path), str(path), FORMAT, VERSION)
    as_fields(record, f"{path}: as `drsplat scan` writes it", **_PARTS)
    return record


def write_scan_record(folder: Path, record: Document) -> None:
    """Replace the record of a folder. Raises: InputError: the disk is full."""
    document = {"format": FORMAT, "version": VERSION, **record}
    write_json(folder / RECORD, document, overwrite=True, end="", default=_plain)


def _plain(value: object) -> object:
    return value.tolist() if hasattr(value, "tolist") else str(value)
