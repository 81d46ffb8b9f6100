"""Tables of objects and of groups in a GLB and in a 3D Tile (EXT_structural_metadata), written and read.

Names are read whoever wrote them, boxes where drsplat did.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..base.arrays import Array, Ids
from ..base.contents import Document
from ..errors import FormatError, InputError
from ..scene.labelled import LabelledScene, Thing, numbers_of
from .gltf import METADATA, Entry, Gltf, inner, listed, whole_number
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


NAME, NUMBER, PARENT, EMBEDDING = "name", "number", "parent", "embedding"
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC3": 3, "MAT3": 9}
_FLOAT = {"componentType": "FLOAT32", "required": True}
_PARENT = {"type": "SCALAR", "componentType": "INT32", "noData": -1}


class Column(NamedTuple):
    """Column of a table, as bytes hold it.

    values: of all rows, one after the other. offsets: where each text begins in them, None for numbers.
    """

    values: Array
    offsets: Array | None = None


class Table(NamedTuple):
    """Table of things of one class.

    kind: its class. properties: what the class says of each column.
    """

    name: str
    kind: str
    num_rows: int
    properties: dict[str, Document]
    columns: dict[str, Column]

    def add(self, name: str, described: Document, column: Column) -> None:
        """Append a column, and what the class says of it."""
        self.properties[name], self.columns[name] = described, column


def tables_of(scene: LabelledScene) -> list[Table]:
    """Return the table of objects and that of groups, where there are some.

    Raises: InputError: embeddings of different lengths.
    """
    if not scene.things:
        return []
    owners = np.zeros(0, np.int32) if scene.object_of is None else scene.object_of
    sizes = np.bincount(owners[owners >= 0], minlength=len(scene.things)).astype("<u4")
    objects = object_table(scene.things, numbers_of(scene.things))
    objects.add(PARENT, _PARENT, _parents(scene.things))
    objects.add("num_gaussians", {"type": "SCALAR", "componentType": "UINT32", "required": True}, Column(sizes))
    _add_embeddings(objects, scene)
    if not scene.groups:
        return [objects]
    groups = _boxes("groups", "group", scene.groups)
    groups.add(PARENT, _PARENT, _parents(scene.groups))
    return [objects, groups]


def object_table(things: Sequence[Thing], numbers: Sequence[int]) -> Table:
    """Return a table of objects: names, scores, boxes and numbers."""
    table = _boxes("objects", "object", things)
    table.add(NUMBER, {"type": "SCALAR", "componentType": "INT32", "required": True}, Column(np.array(numbers, "<i4")))
    return table


def _boxes(name: str, kind: str, things: Sequence[Thing]) -> Table:
    texts = [thing.name.encode(errors="replace") for thing in things]
    offsets = np.cumsum([0, *map(len, texts)])
    table = Table(name, kind, len(things), {}, {})
    names = Column(np.frombuffer(b"".join(texts), np.uint8), offsets.astype("<u4"))
    table.add(NAME, {"type": "STRING", "required": True}, names)
    for column, shape in BOXES.items():  # axes row by row: the columns of this matrix are the box's directions
        numbers = np.array([np.ravel(getattr(thing, column)) for thing in things], "<f4")
        table.add(column, {"type": shape, **_FLOAT}, Column(numbers))
    return table


def _parents(things: Sequence[Thing]) -> Column:
    return Column(np.array([thing.parent for thing in things], "<i4"))


def _add_embeddings(table: Table, scene: LabelledScene) -> None:
    """Append the column of embeddings, a vector of zeros where an object has none; nothing where none has one."""
    lengths = {len(thing.embedding) for thing in scene.things if thing.embedding is not None}
    if not lengths:
        return
    if len(lengths) > 1:
        raise InputError(f"embeddings: expected vectors of one length, got {sorted(lengths)}")
    dim = lengths.pop()
    rows = np.zeros((len(scene.things), dim), "<f4")
    for row, thing in zip(rows, scene.things, strict=True):
        row[:] = 0 if thing.embedding is None else thing.embedding
    encoder = f" of {scene.encoder}" if scene.encoder else ""
    described = {"type": "SCALAR", **_FLOAT, "array": True, "count": dim, "description": f"unit vector{encoder}"}
    table.add(EMBEDDING, described, Column(rows))


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


def object_numbers(gltf: Gltf) -> Ids | None:
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


def _values(gltf: Gltf, table: Entry, name: str, dtype: str, count: int) -> Array:
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


def _numbers(gltf: Gltf, view: object, dtype: str, count: int) -> Array:
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
