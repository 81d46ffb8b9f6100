"""Checksums of a catalogue's files, in checksums.json beside its table: LanceDB has none of its own.

LanceDB writes a file once and never changes it, except for a hint at the latest version. So a record stays true when
versions are added; versions after it come from a process that was killed before it could record them.

Fragments of a version of a LanceDB table, from its manifest.

A manifest ends in where its message of Protocol Buffers begins, 8 bytes, and "LANC"; the message has its length before
it. Source: the Lance table format, `table.proto`.
"""

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
from ...formats.json_files import as_document, as_fields, read_json, write_json
from ...formats.tensors import check_document, check_seal, file_checksum, sealed

NEWEST_FIRST = (1 << 64) - 1  # LanceDB names the manifest of version v NEWEST_FIRST - v, formerly v
MAGIC, FOOTER_BYTES, LENGTH_BYTES = b"LANC", 16, 4
FRAGMENTS, READER_FLAGS, STABLE_ROW_IDS = 2, 9, 2  # of a manifest; the flag: row ids are no addresses
NUMBER, FILES, PHYSICAL_ROWS, PATH = 1, 2, 4, 1  # of a fragment, and of its file
ADDRESS_BITS = 32  # of a row's place in its fragment


class Fragment(NamedTuple):
    """Rows in one file that never changes. data: its name; num_rows: with those that were deleted since."""

    number: int
    data: str
    num_rows: int

    @property
    def first(self) -> int:
        """Id of the first row; the next fragment's are from `first + (1 << 32)` on."""
        return self.number << ADDRESS_BITS

    @property
    def sql(self) -> str:
        """Condition that a row is of this fragment."""
        return f"(_rowid >= {self.first} AND _rowid < {self.first + self.num_rows})"


def manifest_of(table: Path, version: int) -> Path | None:
    """Return the manifest of a version; None if it is missing."""
    paths = (table / "_versions" / f"{number}.manifest" for number in (NEWEST_FIRST - version, version))
    return next((path for path in paths if path.exists()), None)


def fragments_of(manifest: Path) -> list[Fragment] | None:
    """Return the fragments of a version, in order; None if its row ids are no addresses.

    Raises: FormatError: no manifest, or one of fragments in several files.
    """
    content = manifest.read_bytes()
    try:
        begin = int.from_bytes(content[-FOOTER_BYTES : 8 - FOOTER_BYTES], "little") + LENGTH_BYTES
        length = int.from_bytes(content[begin - LENGTH_BYTES : begin], "little")
        message = content[begin : begin + length]
        if not content.endswith(MAGIC) or len(message) != length:
            raise ValueError("cut short")
        parts = list(_fields(message))
        if any(key == READER_FLAGS and int(value) & STABLE_ROW_IDS for key, value in parts):
            return None
        return [_fragment(value) for key, value in parts if key == FRAGMENTS and isinstance(value, bytes)]
    except (IndexError, ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{manifest}: expected the fragments of a LanceDB table ({error!s:.80})") from error


def _fragment(message: bytes) -> Fragment:
    parts = list(_fields(message))
    values = dict(parts)
    (file,) = (value for key, value in parts if key == FILES)
    number, num_rows = int(values.get(NUMBER, 0)), int(values.get(PHYSICAL_ROWS, 0))
    if not (number < 1 << 31 and num_rows < 1 << ADDRESS_BITS):
        raise ValueError(f"{num_rows} rows")
    return Fragment(number, _bytes(dict(_fields(_bytes(file)))[PATH]).decode(), num_rows)


def _bytes(value: int | bytes) -> bytes:
    if not isinstance(value, bytes):
        raise TypeError("a number for a message")
    return value


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield the number and the value of each field. Raises: IndexError, ValueError: no message."""
    at = 0
    while at < len(message):
        key, at = _number(message, at)
        kind = key & 7
        if kind == 0:
            value, at = _number(message, at)
            yield key >> 3, value
            continue
        if kind not in (1, 2, 5):
            raise ValueError(f"field of kind {kind}")
        length, at = _number(message, at) if kind == 2 else ({1: 8, 5: 4}[kind], at)
        if at + length > len(message):
            raise ValueError("cut short")
        yield key >> 3, message[at : at + length]
        at += length


def _number(message: bytes, at: int) -> tuple[int, int]:
    """Return a number of seven bits a byte, the lowest first, and where it ends."""
    value = shift = 0
    while True:
        byte = message[at]
        value, at, shift = value | (byte & 127) << shift, at + 1, shift + 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError("a number of more than 64 bits")


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
    document = as_document(read_json(path), str(path), FORMAT, VERSION, CURE)
    check_seal(document, str(path), cure=CURE)
    parts = as_fields(document, str(path), table=int, files=object, older=object, removed=tuple[str, ...])
    return Record(parts["table"], _files(parts["files"], path), _files(parts["older"], path), parts["removed"])


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
    path = manifest_of(table, version)
    if path is None:
        raise FormatError(f"{table}: the manifest of version {version} is missing. {CURE}")
    of_version = _named_by(path)
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
    write_json(catalogue / RECORD, sealed(document), overwrite=True)


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
