"""Fragments of a version of a LanceDB table, from its manifest.

A manifest ends in where its message of Protocol Buffers begins, 8 bytes, and "LANC"; the message has its length before
it. Source: the Lance table format, `table.proto`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ...errors import FormatError

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
        parts = list(_fields(_message(content)))
        if any(key == READER_FLAGS and int(value) & STABLE_ROW_IDS for key, value in parts):
            return None
        return [_fragment(value) for key, value in parts if key == FRAGMENTS and isinstance(value, bytes)]
    except (IndexError, ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{manifest}: expected the fragments of a LanceDB table ({error!s:.80})") from error


def _message(content: bytes) -> bytes:
    begin = int.from_bytes(content[-FOOTER_BYTES : 8 - FOOTER_BYTES], "little") + LENGTH_BYTES
    length = int.from_bytes(content[begin - LENGTH_BYTES : begin], "little")
    message = content[begin : begin + length]
    if not content.endswith(MAGIC) or len(message) != length:
        raise ValueError("cut short")
    return message


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
