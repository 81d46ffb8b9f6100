"""Tables of objects and of groups in a GLB and in a 3D Tile (EXT_structural_metadata), written and read.

Names are read whoever wrote them, boxes where drsplat did.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..base.arrays import Array, Ids
from ..base.contents import Document
from ..errors import FormatError, InputError
from ..scene.labelled import LabelledScene, Thing, numbers_of
from .gltf import METADATA, NUMBERS_OF_TYPE, Entry, Gltf, inner, listed, whole_number
from .json_files import excerpt
from .labels import Labels

BOXES = {"score": "SCALAR", "center": "VEC3", "extent": "VEC3", "axes": "MAT3"}  # columns of 32-bit floats
OFFSETS = {"UINT8": "<u1", "UINT16": "<u2", "UINT32": "<u4", "UINT64": "<u8"}
NAME, NUMBER, PARENT, EMBEDDING = "name", "number", "parent", "embedding"
_FLOAT = {"componentType": "FLOAT32", "required": True}

Columns = dict[str, tuple[Document, Array, Array | None]]
"""Columns of a table: what its class says, values of all rows in turns, and where texts begin in them, if they are."""


def tables_of(scene: LabelledScene) -> dict[str, Columns]:
    """Return the table of objects and that of groups, where there are some.

    Raises: InputError: embeddings of different lengths.
    """
    if not scene.things:
        return {}
    owners = np.zeros(0, np.int32) if scene.object_of is None else scene.object_of
    sizes = np.bincount(owners[owners >= 0], minlength=len(scene.things)).astype("<u4")
    described = {"type": "SCALAR", "componentType": "UINT32", "required": True}
    objects = object_columns(scene.things, numbers_of(scene.things)) | _parents(scene.things)
    objects |= {"num_gaussians": (described, sizes, None)} | _embeddings(scene)
    return {"objects": objects} | ({"groups": _boxes(scene.groups) | _parents(scene.groups)} if scene.groups else {})


def object_columns(things: Sequence[Thing], numbers: Sequence[int]) -> Columns:
    """Return a table of objects: names, scores, boxes and numbers."""
    described = {"type": "SCALAR", "componentType": "INT32", "required": True}
    return _boxes(things) | {NUMBER: (described, np.array(numbers, "<i4"), None)}


def _boxes(things: Sequence[Thing]) -> Columns:
    texts = [thing.name.encode(errors="replace") for thing in things]
    offsets = np.cumsum([0, *map(len, texts)]).astype("<u4")
    columns: Columns = {NAME: ({"type": "STRING", "required": True}, np.frombuffer(b"".join(texts), np.uint8), offsets)}
    for name, shape in BOXES.items():  # axes row by row: the columns of this matrix are the box's directions
        numbers = np.array([np.ravel(getattr(thing, name)) for thing in things], "<f4")
        columns[name] = ({"type": shape, **_FLOAT}, numbers, None)
    return columns


def _parents(things: Sequence[Thing]) -> Columns:
    described = {"type": "SCALAR", "componentType": "INT32", "noData": -1}
    return {PARENT: (described, np.array([thing.parent for thing in things], "<i4"), None)}


def _embeddings(scene: LabelledScene) -> Columns:
    """Return the column of embeddings, a vector of zeros where an object has none; nothing where none has one."""
    embeddings = [thing.embedding for thing in scene.things]
    lengths = {len(vector) for vector in embeddings if vector is not None}
    if not lengths:
        return {}
    if len(lengths) > 1:
        raise InputError(f"embeddings: expected vectors of one length, got {sorted(lengths)}")
    dim = lengths.pop()
    rows = np.array([np.zeros(dim) if vector is None else vector for vector in embeddings], "<f4")
    encoder = f" of {scene.encoder}" if scene.encoder else ""
    described = {"type": "SCALAR", **_FLOAT, "array": True, "count": dim, "description": f"unit vector{encoder}"}
    return {EMBEDDING: (described, rows, None)}


@dataclass
class _Table:
    """A table that is read. described: what its class says of its columns."""

    gltf: Gltf
    entry: Entry
    described: Entry

    @property
    def count(self) -> int:
        return whole_number(self.entry.get("count"), "a table: count")

    def column(self, name: str) -> Entry:
        return inner(self.entry, "properties", name)

    def says(self, name: str, **expected: str) -> bool:
        """Return whether the class says this of a column."""
        return expected.items() <= inner(self.described, name).items()

    def numbers(self, name: str, dtype: str, width: int = 1) -> Array:
        return self._stored(self.column(name).get("values"), dtype, self.count * width)

    def texts(self) -> list[str]:
        column = self.column(NAME)
        kind = column.get("stringOffsetType", "UINT32")
        if kind not in OFFSETS:
            raise FormatError(f"glTF: offsets of names of the type {excerpt(kind)}: expected {', '.join(OFFSETS)}")
        offsets = self._stored(column.get("stringOffsets"), OFFSETS[kind], self.count + 1).tolist()
        raw = bytes(self.gltf.view(column.get("values")))
        pairs = list(pairwise(offsets))
        if any(end < begin for begin, end in pairs) or offsets[-1] > len(raw):
            raise FormatError("glTF: the names of the objects overlap, or end beyond their bytes: damaged")
        return [raw[begin:end].decode(errors="replace") for begin, end in pairs]

    def _stored(self, view: object, dtype: str, count: int) -> Array:
        raw = self.gltf.view(view)
        if count * np.dtype(dtype).itemsize > len(raw):
            raise FormatError(f"glTF: a table of {count:,} rows does not fit into {len(raw):,} bytes: damaged")
        return np.frombuffer(raw, dtype, count)


def _tables(gltf: Gltf) -> list[_Table]:
    """Return the tables of a file, at least one: that of a file without tables has no columns."""
    metadata = inner(gltf.document, "extensions", METADATA)
    classes: Any = inner(metadata, "schema", "classes")
    entries = [inner(entry) for entry in listed(metadata, "propertyTables", METADATA)[:2]] or [{}]
    names = [entry.get("class") for entry in entries]
    described = [inner(classes, name, "properties") if isinstance(name, str) else {} for name in names]
    return [_Table(gltf, *each) for each in zip(entries, described, strict=True)]


def object_names(gltf: Gltf) -> list[tuple[int, str]]:
    """Return number and name of each object in the first table, in its order, [] where it has no column "name".

    Numbers are those that `Gaussians.extra["object_id"]` has.

    Raises: FormatError: it is damaged.
    """
    table = _tables(gltf)[0]
    if not table.column(NAME) or not table.says(NAME, type="STRING"):
        return []
    names, numbers = table.texts(), object_numbers(gltf)
    return list(zip(range(len(names)) if numbers is None else numbers.tolist(), names, strict=True))


def object_numbers(gltf: Gltf) -> Ids | None:
    """Return the column "number" of the first table, None where there is none. Raises: FormatError: it is damaged."""
    table = _tables(gltf)[0]
    if not table.column(NUMBER) or not table.says(NUMBER, componentType="INT32", type="SCALAR"):
        return None
    return np.asarray(table.numbers(NUMBER, "<i4"), np.int32)


def labels_of_tables(gltf: Gltf) -> Labels:
    """Return the objects and groups with their boxes, as drsplat writes them; none out of other tables.

    Raises: FormatError: a table is damaged.
    """
    first, *others = _tables(gltf)
    groups = _things(others[0], 1 << 31) if others else ()
    return Labels(_things(first, len(groups)), groups)


def _things(table: _Table, num_groups: int) -> tuple[Thing, ...]:
    if not all(table.says(name, type=kind, componentType="FLOAT32") for name, kind in BOXES.items()):
        return ()
    count = table.count
    boxes = [
        table.numbers(name, "<f4", NUMBERS_OF_TYPE[kind]).astype(np.float64).reshape(count, -1)
        for name, kind in BOXES.items()
    ]
    parents, numbers = (
        table.numbers(name, "<i4") if name in table.described else np.full(count, -1) for name in (PARENT, NUMBER)
    )
    names = table.texts()
    if not (all(np.isfinite(box).all() for box in boxes) and (parents >= -1).all() and (parents < num_groups).all()):
        raise FormatError("glTF: boxes of objects that are not finite, or groups that are not there: damaged")
    rows = zip(names, *boxes, parents.tolist(), numbers.tolist(), strict=True)
    return tuple(
        Thing(name, float(score[0]), center, axes.reshape(3, 3), extent, parent, number=number)
        for name, score, center, extent, axes, parent, number in rows
    )
