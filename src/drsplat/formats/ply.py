"""PLY as tables: read elements by header into structured arrays, write one `vertex` element; point clouds of any tool.

Source: Greg Turk, "The PLY Polygon File Format" (1994). Little- and big-endian binary and ASCII.
"""

import io
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Array, Arrays, Colors, FloatRows, Points, Shaped
from ..base.contents import AnyPath, file_bytes
from ..errors import FormatError, InputError, placed, warn
from .replacing import replacing

AXES, COLORS = ("x", "y", "z"), ("red", "green", "blue")
DEFAULT_GREY = 128  # of points without colour


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


Records = np.ndarray  # structured: a row each; jaxtyping would spell out its dtype at every call
BLOCK_ROWS = 2048  # of 62 floats fit a core's second-level cache
WRITTEN_TYPES = {code: name for name, code in reversed(SCALAR_TYPES.items()) if name.isalpha() and code != "f2"}


def read_elements(buffer: memoryview, header: Header, names: Collection[str]) -> dict[str, Records]:
    """Read the named elements, each as a structured array with one row per entry.

    Rows of a binary file are views of `buffer`: nothing is copied, whatever its size. All elements
    in front of the last one named are stepped over, lists included.

    Raises: FormatError: an element is missing, holds lists, or is longer than the file.
    """
    for name in names:
        if name not in header.elements:
            raise FormatError(f"PLY has no element '{name}', only {', '.join(header.elements) or 'none'}")
        if header.elements[name].has_lists or not header.elements[name].properties:
            raise FormatError(f"PLY element '{name}' must hold scalar properties, and only those")
    if header.order == "=":
        found: Arrays = {}
        rows = (line for line in io.BytesIO(buffer[header.body :]) if not line.isspace())
        for element in header.elements.values():
            if len(found) == len(names):
                break
            if element.name in names:
                found[element.name] = _ascii_rows(rows, element)
            elif sum(1 for _ in islice(rows, element.count)) < element.count:
                raise FormatError(f"PLY is truncated: fewer than {element.count} lines of '{element.name}'")
        return found
    return _read_binary(buffer, header, names)


def _read_binary(buffer: memoryview, header: Header, names: Collection[str]) -> dict[str, Records]:
    found: Arrays = {}
    offset = header.body
    for element in header.elements.values():
        if element.has_lists:
            if len(found) == len(names):
                return found
            offset = _end_of_lists(buffer, offset, element, header.order)
            continue
        record = element.record(header.order)
        end = offset + element.count * record.itemsize
        if end > len(buffer):
            raise FormatError(
                f"PLY is truncated or its header is wrong: {element.count} rows of "
                f"'{element.name}' end at byte {end}, the file at {len(buffer)}"
            )
        if element.name in names:
            found[element.name] = np.frombuffer(buffer, record, element.count, offset)
        offset = end
    if offset < len(buffer):
        left_out = len(buffer) - offset
        warn(f"{left_out} bytes after the last PLY element were left out", 3)
    return found


def _end_of_lists(buffer: memoryview, offset: int, element: Element, order: str) -> int:
    # Every list has a length of a byte or more, so the file bounds the walk whatever `count` says.
    sizes = [(np.dtype(p.code).itemsize, np.dtype(p.count_code or "u1").itemsize, p) for p in element.properties]
    byte_order = "little" if order == "<" else "big"
    for _ in range(element.count):
        for item_size, length_size, p in sizes:
            if p.count_code:
                signed = p.count_code[0] == "i"
                raw = bytes(buffer[offset : offset + length_size])
                length = int.from_bytes(raw, byte_order, signed=signed)  # type: ignore[arg-type]
                offset += length_size + max(length, 0) * item_size
            else:
                offset += item_size
        if offset > len(buffer):
            raise FormatError(f"PLY is truncated or damaged in the lists of '{element.name}'")
    return offset


def _ascii_rows(rows: Iterator[bytes], element: Element) -> Records:
    result: Array = np.empty(0, element.record("="))
    lines = list(islice(rows, element.count))
    if len(lines) < element.count:
        raise FormatError(f"PLY is truncated: {len(lines)} of {element.count} lines of '{element.name}'")
    if not lines:
        return result
    try:
        table = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise FormatError(f"PLY text of '{element.name}' is damaged: {error}") from None
    if table.shape != (element.count, len(element.properties)):
        raise FormatError(
            f"PLY text of '{element.name}': expected {len(element.properties)} numbers a line, got {table.shape[1]}"
        )
    result = np.empty(element.count, result.dtype)
    for column, p in zip(table.T, element.properties, strict=True):
        result[p.name] = column
        if p.code[0] != "f" and (result[p.name] != column).any():
            raise FormatError(f"PLY property '{p.name}' is declared {p.code} but holds other numbers")
    return result


def gather(records: Records, names: Sequence[str]) -> FloatRows:
    """Return the columns `names` of a structured array side by side as float32, whatever their type.

    A value that float32 cannot hold becomes infinite: judging it is the caller's.
    """
    result = np.empty((len(records), len(names)), np.float32)
    # the places of the columns in a record that is seen as float32 words, where it can be
    fields = [records.dtype.fields[name] for name in names] if records.dtype.fields else []
    is_words = not records.dtype.itemsize % 4 and all(f[0] == np.float32 and not f[1] % 4 for f in fields)
    words = [f[1] // 4 for f in fields] if is_words else None
    for start in range(0, len(records), BLOCK_ROWS):
        rows = slice(start, start + BLOCK_ROWS)
        block = records[rows]
        if words is not None:
            table = block.view(np.float32).reshape(len(block), -1)
            np.take(table, words, axis=1, out=result[rows], mode="clip")
            continue
        for column, name in enumerate(names):
            result[rows, column] = block[name]
    return result


def write_vertices(
    path: AnyPath, columns: Mapping[str, Shaped[Array, " n"]], overwrite: bool = False,
    comments: Sequence[str] = (),
) -> None:  # fmt: skip
    """Write a binary little-endian PLY, atomically: one element `vertex`, a property per column.

    comments: lines of the header.

    Raises: InputError: a name or type PLY cannot hold, unequal lengths, or `path` exists already.
    """
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1:
        raise InputError(f"PLY columns must be of one length, got {sorted(lengths)}")
    count = lengths.pop()
    record = np.dtype([(name, _code(name, column)) for name, column in columns.items()])
    header = [  # no comment before it: viewers of 3DGS take the third line for the count
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {count}",
        *(f"comment {comment}" for comment in comments),
    ]
    header += [f"property {WRITTEN_TYPES[record[name].str[1:]]} {name}" for name in columns]
    with replacing(path, overwrite) as file:
        file.write("\n".join([*header, "end_header\n"]).encode("ascii"))
        for start in range(0, count, BLOCK_ROWS):
            rows = slice(start, min(start + BLOCK_ROWS, count))
            block = np.empty(rows.stop - rows.start, record)
            for name, column in columns.items():
                block[name] = column[rows]
            file.write(block.data)


def _code(name: str, column: Shaped[Array, " n"]) -> str:
    if not (name.isascii() and name.isprintable() and name and " " not in name):
        raise InputError(f"'{name}' cannot name a PLY property: use printable ASCII without spaces")
    code = column.dtype.newbyteorder("<").str[1:]
    if code not in WRITTEN_TYPES:
        raise InputError(
            f"column '{name}' is {column.dtype}, which PLY cannot hold: cast it to float32, float64, int32 or uint8"
        )
    return "<" + code


def read_point_ply(path: AnyPath) -> tuple[Points, Colors]:
    """Return the positions and RGB of the element `vertex`, in file order; other elements and properties are left out.

    red, green and blue are whole numbers up to 255, or fractions up to 1; without them points are grey.

    Raises: InputError: there is no such file. FormatError: no PLY, truncated, without x, y, z, or a
    point that is not finite.
    """
    path = Path(path)
    buffer = file_bytes(path).data
    try:
        return _points(read_elements(buffer, read_header(buffer), {"vertex"})["vertex"])
    except FormatError as error:
        raise FormatError(placed(path, error)) from None


def _points(rows: Records) -> tuple[Array, Array]:
    names = rows.dtype.names or ()
    missing = [name for name in AXES if name not in names]
    if missing:
        raise FormatError(f"no points: vertex has no {', '.join(missing)}")
    positions = np.stack([rows[name].astype(np.float64) for name in AXES], axis=1)
    bad = np.flatnonzero(~np.isfinite(positions).all(1))
    if len(bad):
        raise FormatError(f"{len(bad)} of {len(rows)} points are not finite, the first at index {bad[0]}")
    if not set(COLORS) <= set(names):
        return positions, np.full(positions.shape, DEFAULT_GREY, np.uint8)
    colors = np.stack([rows[name] for name in COLORS], axis=1)
    with np.errstate(all="ignore"):  # judged below
        scaled = colors * 255.0 if colors.dtype.kind == "f" else colors.astype(np.float64)
    if not ((scaled >= 0) & (scaled <= 255)).all():
        raise FormatError("expected colours of 0 to 255, or of 0 to 1 where they are fractions")
    return positions, np.rint(scaled).astype(np.uint8)
