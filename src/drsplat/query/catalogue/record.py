"""Checksums of a catalogue's files, in checksums.json beside its table: LanceDB has none of its own.

LanceDB writes a file once and never changes it, except for a hint at the latest version. So a record stays true when
versions are added; versions after it come from a process that was killed before it could record them.
"""

import json
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from uuid import UUID

from ...errors import FormatError
from ...formats.checksums import check_document, check_seal, file_checksum, sealed
from ...formats.json_files import is_text, read_json
from ...formats.replacing import replacing
from .manifest import manifest_of

RECORD, FORMAT, VERSION = "checksums.json", "drsplat catalogue checksums", 1
HINT = "_versions/latest_version_hint.json"
SMALL_BYTES = 64 << 20  # tables up to this size are compared whole whenever they are opened
SETTLED_S = 2.0  # file clocks are coarse: a change within this time may leave a file's time as it is
CURE = (
    "Restore the folder from a copy, or remove it and add its scenes again; where the table itself is what you want, "
    f"remove {RECORD}, which the next `drsplat catalogue add` writes anew"
)
_NAME = re.compile(r"[\w-][\w.-]*(/[\w-][\w.-]*)+")
_WRITTEN_AT_ONCE = ("_versions/*.manifest", "_transactions/*.txn", "_deletions/*", HINT)
_NAMED_BY_MANIFESTS = ("data/*", "_indices/*/*", "_transactions/*.txn")


class Summed(NamedTuple):
    """Size and checksum of a file."""

    num_bytes: int
    crc32: str


@dataclass(frozen=True)
class Record:
    """Recorded state of a table.

    version: of the table. files: those of this version, by name in the table's folder. older: those of versions before
    it, which may be deleted at any time. removed: names of scenes that were removed and not added again.
    """

    version: int
    files: Mapping[str, Summed]
    older: Mapping[str, Summed]
    removed: tuple[str, ...] = ()

    def check_files(self, table: Path, whole: bool = False) -> None:
        """Compare the files of a table that exist with the record, before LanceDB reads them.

        Sizes and manifests are always compared; the content of all files if they are small together, or if `whole`.

        Raises: FormatError: another file than was written.
        """
        recorded = {**self.older, **self.files}
        whole = whole or sum(file.num_bytes for file in recorded.values()) <= SMALL_BYTES
        for name, file in recorded.items():
            if name != HINT:
                _compare(table / name, file, whole or name.endswith(".manifest"))

    def check_version(self, table: Path, version: int) -> None:
        """Compare the version of an opened table with the recorded one.

        Raises: FormatError: it is older, or files of it are missing.
        """
        if version < self.version:
            raise FormatError(
                f"{table}: version {version} is the newest that is here, and version {self.version} was written: its "
                f"manifest is missing. {CURE}"
            )
        if version > self.version:
            return
        for name in self.files:
            if not (table / name).exists():
                raise FormatError(f"{table / name}: missing. {CURE}")
        if HINT in self.older:
            _compare(table / HINT, self.older[HINT], is_whole=True)


def read_record(catalogue: Path) -> Record | None:
    """Read the record of a catalogue; None for an older format, or if nothing was added yet.

    Raises: FormatError: a damaged record.
    """
    path = catalogue / RECORD
    if not path.exists():
        return None
    document = read_json(path)
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise FormatError(f"{path}: expected '{FORMAT}' of version {VERSION}. {CURE}")
    check_seal(document, str(path), cure=CURE)
    version, removed = document.get("table"), document.get("removed")
    if type(version) is not int or not isinstance(removed, list) or not all(map(is_text, removed)):
        raise FormatError(f"{path}: expected the table's version and names of scenes. {CURE}")
    files, older = (_files(document.get(key), path) for key in ("files", "older"))
    return Record(version, files, older, tuple(removed))


def verify_record(catalogue: Path, table: Path) -> list[str]:
    """Compare every byte of the recorded files; return their names, in the catalogue's folder.

    Raises: FormatError: damage.
    """
    record = read_record(catalogue)
    if record is None:
        return []
    check_document(catalogue / RECORD)
    record.check_files(table, whole=True)
    here = [name for name in (*record.files, *record.older) if (table / name).exists()]
    return sorted([RECORD, *(f"{table.name}/{name}" for name in here)])


def write_record(catalogue: Path, table: Path, version: int, removed: Iterable[str]) -> None:
    """Record a version of the table and all before it; the caller must hold the writer's lock.

    Files that were recorded already are not read again. Raises: as `replacing`.
    """
    before = read_record(catalogue)
    recorded = {**before.older, **before.files} if before else {}
    of_version = _named_by(_manifest(table, version))
    names = {*recorded, *of_version, *_finished(table)} - {HINT}
    for manifest in (table / "_versions").glob("*.manifest"):
        if manifest.relative_to(table).as_posix() not in recorded:
            names |= _named_by(manifest)
    sums = {name: recorded.get(name) or _summed(table / name) for name in names if (table / name).exists()}
    if (table / HINT).exists():
        sums[HINT] = _summed(table / HINT)
    document = {
        "format": FORMAT, "version": VERSION, "table": version, "removed": sorted(set(removed)),
        "files": {name: sums[name] for name in sorted(sums) if name in of_version},
        "older": {name: sums[name] for name in sorted(sums) if name not in of_version},
    }  # fmt: skip
    with replacing(catalogue / RECORD, overwrite=True) as out:
        out.write((json.dumps(sealed(document), indent=1) + "\n").encode())


def _files(document: object, path: Path) -> dict[str, Summed]:
    if not isinstance(document, dict):
        raise FormatError(f"{path}: expected files by name. {CURE}")
    for name, entry in document.items():
        is_pair = isinstance(entry, list) and len(entry) == 2
        if not _NAME.fullmatch(name) or not is_pair or type(entry[0]) is not int or type(entry[1]) is not str:
            raise FormatError(f"{path}: {name!a:.80}: expected the size and the checksum of a file. {CURE}")
    return {name: Summed(*entry) for name, entry in document.items()}


def _compare(path: Path, file: Summed, is_whole: bool) -> None:
    """Compare a file, if it is there, with its size, and its content if `is_whole`. Raises: FormatError."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return
    if status.st_size != file.num_bytes or (is_whole and _checksum(path, status) != file.crc32):
        raise FormatError(f"{path}: damaged: it is not what was written. {CURE}")


def _summed(path: Path) -> Summed:
    return Summed(path.stat().st_size, file_checksum(path))


def _checksum(path: Path, status: os.stat_result) -> str:
    """Return the checksum of a file; those of unchanged files are cached in this process."""
    if time.time() - status.st_mtime < SETTLED_S:
        return file_checksum(path)
    return _checksum_of(path, status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=10_000)
def _checksum_of(path: Path, *_: int) -> str:
    return file_checksum(path)


def _finished(table: Path) -> Iterator[str]:
    """Yield the names of the files that are never half-written while the writer's lock is held."""
    for pattern in _WRITTEN_AT_ONCE:
        for path in table.glob(pattern):
            name = path.relative_to(table).as_posix()
            if path.is_file() and _NAME.fullmatch(name):
                yield name


def _manifest(table: Path, version: int) -> Path:
    path = manifest_of(table, version)
    if path is None:
        raise FormatError(f"{table}: the manifest of version {version} is missing. {CURE}")
    return path


def _named_by(manifest: Path) -> set[str]:
    """Return the names of a manifest and of the files that its version needs.

    A manifest is a message of Protocol Buffers that has names of files as text and indices by the bytes of their UUID.
    Deletions are left out: it has only their numbers, and without one LanceDB does not read the table.
    """
    table, content = manifest.parent.parent, manifest.read_bytes()
    names = {manifest.relative_to(table).as_posix()}
    for pattern in _NAMED_BY_MANIFESTS:
        for path in table.glob(pattern):
            name = path.relative_to(table).as_posix()
            if _NAME.fullmatch(name) and _is_named(path, content):
                names.add(name)
    return names


def _is_named(path: Path, manifest: bytes) -> bool:
    if path.parent.parent.name != "_indices":
        return path.name.encode() in manifest
    try:
        return UUID(path.parent.name).bytes in manifest
    except ValueError:
        return False
