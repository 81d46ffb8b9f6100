"""The header of a PLY file: which elements and properties its body claims to hold.

Source: Greg Turk, "The PLY Polygon File Format" (1994).
"""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import FormatError

MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8, which some editors put before text
MAX_HEADER_BYTES = 1 << 20
SCALAR_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8", "float16": "f2", "half": "f2"},
}
LENGTH_TYPES = {name for name, code in SCALAR_TYPES.items() if code[0] != "f"}
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


class Property(NamedTuple):
    """One property: `code` is its NumPy type; `count_code` that of a list's length, else empty."""

    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class Element:
    """`count` rows of `properties`; nothing here has been checked against the file's size yet."""

    name: str
    count: int
    properties: tuple[Property, ...]

    def __post_init__(self) -> None:
        twice = [name for name, times in Counter(self.names()).items() if times > 1]
        if twice:
            raise FormatError(f"PLY header names the property '{twice[0]}' twice")

    @property
    def has_lists(self) -> bool:
        return any(p.count_code for p in self.properties)

    def names(self) -> list[str]:
        return [p.name for p in self.properties]

    def record(self, order: str) -> np.dtype:
        """Return one row as a packed NumPy record."""
        return np.dtype([(p.name, order + p.code) for p in self.properties])


@dataclass(frozen=True)
class Header:
    """Header of a PLY file. `order`: "<", ">" or, for ASCII, "="; `body`: its offset. comments: in order."""

    order: str
    elements: dict[str, Element]
    body: int
    comments: tuple[str, ...] = ()


def read_header(buffer: memoryview) -> Header:
    """Parse the header, in which no number is to be trusted yet.

    Raises: FormatError: not PLY, or a header that is damaged or longer than 1 MiB.
    """
    head = bytes(buffer[: 1 << 14])
    begin = len(MARK) * head.startswith(MARK)
    if not head.startswith((b"ply\n", b"ply\r\n"), begin):
        raise FormatError("not a PLY file: it does not begin with the line 'ply'")
    if b"\nend_header" not in head:
        head = bytes(buffer[:MAX_HEADER_BYTES])
    end = head.find(b"\nend_header")
    line_end = head.find(b"\n", end + 1)
    if end < 0 or line_end < 0 or head[end + 11 : line_end].strip():
        raise FormatError("PLY header has no 'end_header' line: the file is truncated or damaged")
    lines = head[begin + 4 : end].decode("latin-1").split("\n")
    order, elements = _parse_lines(lines)
    comments = tuple(line.partition(" ")[2].strip() for line in lines if line.startswith(("comment ", "obj_info ")))
    return Header(order, elements, line_end + 1, comments)


def _parse_lines(lines: list[str]) -> tuple[str, dict[str, Element]]:
    order = ""
    counts: dict[str, int] = {}
    properties: dict[str, list[Property]] = {}
    current: list[Property] | None = None
    for line in lines:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", encoding, "1.0"] if encoding in BYTE_ORDERS and not order:
                order = BYTE_ORDERS[encoding]
            case ["element", name, count] if count.isdecimal() and len(count) < 19 and name not in counts:
                counts[name] = int(count)
                current = properties[name] = []
            case ["property", kind, name] if kind in SCALAR_TYPES and current is not None:
                current.append(Property(name, SCALAR_TYPES[kind]))
            case ["property", "list", length, kind, name] if (
                kind in SCALAR_TYPES and length in LENGTH_TYPES and current is not None
            ):
                current.append(Property(name, SCALAR_TYPES[kind], SCALAR_TYPES[length]))
            case _:
                raise FormatError(f"PLY header line not understood: {line[:80]!r}")
    if not order:
        raise FormatError("PLY header has no 'format' line")
    return order, {name: Element(name, counts[name], tuple(properties[name])) for name in counts}
