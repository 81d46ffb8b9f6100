"""Names of objects out of the tables of a glTF (EXT_structural_metadata), whoever wrote them."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..base.arrays import Int32
from ..errors import FormatError
from .glb_layout import METADATA
from .glb_tables import NAME, NUMBER
from .gltf import Entry, Gltf, inner, listed, whole_number
from .json_files import excerpt

OFFSETS = {"UINT8": "<u1", "UINT16": "<u2", "UINT32": "<u4", "UINT64": "<u8"}


class ObjectName(NamedTuple):
    """Number and name of an object.

    number: as `Gaussians.extra["object_id"]` has it.
    """

    number: int
    name: str


def object_names(gltf: Gltf) -> list[ObjectName]:
    """Return the names in the first table, in its order, [] where it has no column "name".

    Raises: FormatError: it is damaged.
    """
    table = _table(gltf)
    column = inner(table, "properties", NAME)
    if not column or inner(_class(gltf, table), NAME).get("type") != "STRING":
        return []
    count = whole_number(table.get("count"), "a table: count")
    numbers = object_numbers(gltf)
    names = _texts(gltf, column, count)
    return [ObjectName(row if numbers is None else int(numbers[row]), name) for row, name in enumerate(names)]


def object_numbers(gltf: Gltf) -> Int32[np.ndarray, " t"] | None:
    """Return the column "number" of the first table, None where there is none. Raises: FormatError: it is damaged."""
    table = _table(gltf)
    column, described = inner(table, "properties", NUMBER), inner(_class(gltf, table), NUMBER)
    if not column or described.get("componentType") != "INT32" or described.get("type") != "SCALAR":
        return None
    count = whole_number(table.get("count"), "a table: count")
    return np.asarray(_numbers(gltf, column.get("values"), "<i4", count), np.int32)


def _table(gltf: Gltf) -> Entry:
    tables = listed(inner(gltf.document, "extensions", METADATA), "propertyTables", METADATA)
    return inner(tables[0]) if tables else {}


def _class(gltf: Gltf, table: Entry) -> Entry:
    """Return the properties that the table's class describes."""
    name = table.get("class")
    known = inner(gltf.document, "extensions", METADATA, "schema", "classes")
    return inner(known, name, "properties") if isinstance(name, str) else {}


def _numbers(gltf: Gltf, view: object, dtype: str, count: int) -> np.ndarray:
    raw = gltf.view(view)
    if count * np.dtype(dtype).itemsize > len(raw):
        raise FormatError(f"glTF: a table of {count:,} rows does not fit into {len(raw):,} bytes: damaged")
    return np.frombuffer(raw, dtype, count)


def _texts(gltf: Gltf, column: Entry, count: int) -> list[str]:
    kind = column.get("stringOffsetType", "UINT32")
    if kind not in OFFSETS:
        raise FormatError(f"glTF: offsets of names of the type {excerpt(kind)}: expected {', '.join(OFFSETS)}")
    offsets = _numbers(gltf, column.get("stringOffsets"), OFFSETS[kind], count + 1).tolist()
    raw = bytes(gltf.view(column.get("values")))
    pairs = list(pairwise(offsets))
    if any(end < begin for begin, end in pairs) or offsets[-1] > len(raw):
        raise FormatError("glTF: the names of the objects overlap, or end beyond their bytes: damaged")
    return [raw[begin:end].decode(errors="replace") for begin, end in pairs]
