"""Objects out of the tables of a glTF (EXT_structural_metadata): names, whoever wrote them, and our boxes."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..base.arrays import Int32
from ..errors import FormatError
from ..scene.labelled import Thing
from .glb_layout import METADATA
from .glb_tables import NAME, NUMBER, NUMBERS_OF_TYPE, PARENT
from .gltf import Entry, Gltf, inner, listed, whole_number
from .json_files import excerpt
from .labels import Labels

BOXES = {"score": "SCALAR", "center": "VEC3", "extent": "VEC3", "axes": "MAT3"}  # columns of 32-bit floats
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


def labels_of_tables(gltf: Gltf) -> Labels:
    """Return the objects and groups with their boxes, as drsplat writes them; none out of other tables.

    Raises: FormatError: a table is damaged.
    """
    tables = [inner(table) for table in _tables(gltf)[:2]]
    groups = _things(gltf, tables[1], 1 << 31) if len(tables) > 1 else ()
    things = _things(gltf, tables[0], len(groups)) if tables else ()
    return Labels(things, groups)


def _things(gltf: Gltf, table: Entry, num_groups: int) -> tuple[Thing, ...]:
    described = _class(gltf, table)
    kinds = {name: inner(described, name).get("type") for name in BOXES}
    if kinds != BOXES or any(inner(described, name).get("componentType") != "FLOAT32" for name in BOXES):
        return ()
    count = whole_number(table.get("count"), "a table: count")
    columns = {name: _values(gltf, table, name, "<f4", count * NUMBERS_OF_TYPE[kind]) for name, kind in BOXES.items()}
    names = _texts(gltf, inner(table, "properties", NAME), count)
    boxes = [columns[name].astype(np.float64).reshape(count, -1) for name in BOXES]
    none = np.full(count, -1)
    parents = _values(gltf, table, PARENT, "<i4", count) if PARENT in described else none
    numbers = _values(gltf, table, NUMBER, "<i4", count) if NUMBER in described else none
    if not (all(np.isfinite(box).all() for box in boxes) and (parents >= -1).all() and (parents < num_groups).all()):
        raise FormatError("glTF: boxes of objects that are not finite, or groups that are not there: damaged")
    rows = zip(names, *boxes, parents.tolist(), numbers.tolist(), strict=True)
    return tuple(
        Thing(name, float(score[0]), center, axes.reshape(3, 3), extent, parent, number=number)
        for name, score, center, extent, axes, parent, number in rows
    )


def _values(gltf: Gltf, table: Entry, name: str, dtype: str, count: int) -> np.ndarray:
    return _numbers(gltf, inner(table, "properties", name).get("values"), dtype, count)


def _tables(gltf: Gltf) -> list[object]:
    return listed(inner(gltf.document, "extensions", METADATA), "propertyTables", METADATA)


def _table(gltf: Gltf) -> Entry:
    tables = _tables(gltf)
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
