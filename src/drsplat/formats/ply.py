"""PLY as tables: read elements by header into structured arrays, write one `vertex` element.

Source: Greg Turk, "The PLY Polygon File Format" (1994). Little- and big-endian binary and ASCII.
"""

import io
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import islice
from os import PathLike

import numpy as np

from ..base.arrays import Float32, Shaped
from ..errors import DrSplatWarning, FormatError, InputError
from .ply_header import SCALAR_TYPES, Element, Header
from .replacing import replacing

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
        return _read_ascii(io.BytesIO(buffer[header.body :]), header, names)
    return _read_binary(buffer, header, names)


def _read_binary(buffer: memoryview, header: Header, names: Collection[str]) -> dict[str, Records]:
    found: dict[str, np.ndarray] = {}
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
        warnings.warn(f"{left_out} bytes after the last PLY element were left out", DrSplatWarning, stacklevel=3)
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


def _read_ascii(text: io.BytesIO, header: Header, names: Collection[str]) -> dict[str, Records]:
    found: dict[str, np.ndarray] = {}
    rows = (line for line in text if not line.isspace())
    for element in header.elements.values():
        if len(found) == len(names):
            break
        if element.name in names:
            found[element.name] = _ascii_rows(rows, element)
        elif sum(1 for _ in islice(rows, element.count)) < element.count:
            raise FormatError(f"PLY is truncated: fewer than {element.count} lines of '{element.name}'")
    return found


def _ascii_rows(rows: Iterator[bytes], element: Element) -> Records:
    result: np.ndarray = np.empty(0, element.record("="))
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


def gather(records: Records, names: Sequence[str]) -> Float32[np.ndarray, "n c"]:
    """Return the columns `names` of a structured array side by side as float32, whatever their type.

    A value that float32 cannot hold becomes infinite: judging it is the caller's.
    """
    result = np.empty((len(records), len(names)), np.float32)
    words = _float32_words(records.dtype, names)
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


def _float32_words(record: np.dtype, names: Sequence[str]) -> list[int] | None:
    """Return the positions of the columns in a record seen as float32 words; None if it cannot be so seen."""
    fields = [record.fields[name] for name in names] if record.fields else []
    if record.itemsize % 4 or any(f[0] != np.float32 or f[1] % 4 for f in fields):
        return None
    return [f[1] // 4 for f in fields]


def write_vertices(
    path: str | PathLike[str], columns: Mapping[str, Shaped[np.ndarray, " n"]], overwrite: bool = False,
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


def _code(name: str, column: Shaped[np.ndarray, " n"]) -> str:
    if not (name.isascii() and name.isprintable() and name and " " not in name):
        raise InputError(f"'{name}' cannot name a PLY property: use printable ASCII without spaces")
    code = column.dtype.newbyteorder("<").str[1:]
    if code not in WRITTEN_TYPES:
        raise InputError(
            f"column '{name}' is {column.dtype}, which PLY cannot hold: cast it to float32, float64, int32 or uint8"
        )
    return "<" + code
