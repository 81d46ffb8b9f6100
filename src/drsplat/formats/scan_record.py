"""scan.json: what a folder was scanned from, with which options, and which stages are done.

format, version   "drsplat scan", 1
input             path, kind (photos, video or capture) and fingerprint
capture           folder of the posed photos, absolute or inside the scan's folder
models            segmenter and encoder that embedded the photos
stages            by name: options, whether it is done, its seconds and what it answered
"""

import json
from pathlib import Path
from typing import Any

from ..errors import FormatError
from .json_files import read_json
from .replacing import replacing

RECORD = "scan.json"
FORMAT, VERSION = "drsplat scan", 1
MODEL, CAPTURE = "model", "capture"


def read_scan_record(folder: Path) -> dict[str, Any] | None:
    """Return the record of a scanned folder, None where there is none.

    Raises: FormatError: damaged, or of a later version.
    """
    path = folder / RECORD
    if not path.is_file():
        return None
    record = read_json(path)
    sound = isinstance(record, dict) and record.get("format") == FORMAT
    if not sound or not isinstance(record, dict) or record.get("version") != VERSION:
        raise FormatError(f"{path}: expected the record of a scan, version {VERSION}")
    parts = {"input": dict, "capture": str, "models": dict, "stages": dict}
    for name, kind in parts.items():
        if not isinstance(record.get(name), kind):
            raise FormatError(f"{path}: expected {name} as `drsplat scan` writes it")
    if any(not isinstance(stage, dict) or "options" not in stage for stage in record["stages"].values()):
        raise FormatError(f"{path}: expected stages as `drsplat scan` writes them")
    return record


def write_scan_record(folder: Path, record: dict[str, Any]) -> None:
    """Replace the record of a folder. Raises: InputError: the disk is full."""
    document = {"format": FORMAT, "version": VERSION, **record}
    with replacing(folder / RECORD, overwrite=True) as file:
        file.write(json.dumps(document, indent=1, default=_plain).encode())


def _plain(value: object) -> object:
    return value.tolist() if hasattr(value, "tolist") else str(value)
