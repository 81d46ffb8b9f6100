"""Tables of objects and of groups in a GLB and in a 3D Tile: EXT_structural_metadata."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..scene.labelled import LabelledScene, Thing, numbers_of

NAME, NUMBER, PARENT, EMBEDDING = "name", "number", "parent", "embedding"
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC3": 3, "MAT3": 9}
_FLOAT = {"componentType": "FLOAT32", "required": True}
_PARENT = {"type": "SCALAR", "componentType": "INT32", "noData": -1}


class Column(NamedTuple):
    """Column of a table, as bytes hold it.

    values: of all rows, one after the other. offsets: where each text begins in them, None for numbers.
    """

    values: np.ndarray
    offsets: np.ndarray | None = None


class Table(NamedTuple):
    """Table of things of one class.

    kind: its class. properties: what the class says of each column.
    """

    name: str
    kind: str
    num_rows: int
    properties: dict[str, dict[str, Any]]
    columns: dict[str, Column]

    def add(self, name: str, described: dict[str, Any], column: Column) -> None:
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
    table.add("score", {"type": "SCALAR", **_FLOAT}, _floats(things, lambda thing: [thing.score]))
    table.add("center", {"type": "VEC3", **_FLOAT}, _floats(things, lambda thing: thing.center))
    table.add("extent", {"type": "VEC3", **_FLOAT}, _floats(things, lambda thing: thing.extent))
    # stored column by column: the columns of this matrix are the box's directions
    table.add("axes", {"type": "MAT3", **_FLOAT}, _floats(things, lambda thing: thing.axes.ravel()))
    return table


def _floats(things: Sequence[Thing], numbers: Callable[[Thing], Any]) -> Column:
    return Column(np.array([numbers(thing) for thing in things], "<f4"))


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
