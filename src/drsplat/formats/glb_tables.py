"""Tables of objects and of groups in a GLB: EXT_structural_metadata."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..scene.labelled import LabelledScene, Thing

NAME, NUMBER, PARENT, EMBEDDING = "name", "number", "parent", "embedding"
LENGTHS = {"SCALAR": 1, "VEC3": 3, "MAT3": 9}
_FLOAT = {"componentType": "FLOAT32", "required": True}


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


def tables_of(scene: LabelledScene) -> list[Table]:
    """Return the table of objects and that of groups, where there are some.

    Raises: InputError: embeddings of different lengths.
    """
    if not scene.things:
        return []
    owners = np.zeros(0, np.int32) if scene.object_of is None else scene.object_of
    sizes = np.bincount(owners[owners >= 0], minlength=len(scene.things)).astype("<u4")
    objects = _table("objects", "object", scene.things)
    own = {
        NUMBER: ({"type": "SCALAR", "componentType": "INT32", "required": True}, _numbers(scene.things)),
        "num_gaussians": ({"type": "SCALAR", "componentType": "UINT32", "required": True}, Column(sizes)),
        **_embeddings(scene),
    }
    for name, (described, column) in own.items():
        objects.properties[name], objects.columns[name] = described, column
    return [objects, _table("groups", "group", scene.groups)] if scene.groups else [objects]


def _table(name: str, kind: str, things: Sequence[Thing]) -> Table:
    texts = [thing.name.encode(errors="replace") for thing in things]
    offsets = np.cumsum([0, *map(len, texts)])
    properties: dict[str, dict[str, Any]] = {
        NAME: {"type": "STRING", "required": True},
        "score": {"type": "SCALAR", **_FLOAT},
        "center": {"type": "VEC3", **_FLOAT},
        "extent": {"type": "VEC3", **_FLOAT},
        "axes": {"type": "MAT3", **_FLOAT},  # stored column by column: its columns are the box's directions
        PARENT: {"type": "SCALAR", "componentType": "INT32", "noData": -1},
    }
    columns = {
        NAME: Column(np.frombuffer(b"".join(texts), np.uint8), offsets.astype("<u4")),
        "score": _floats(things, lambda thing: [thing.score]),
        "center": _floats(things, lambda thing: thing.center),
        "extent": _floats(things, lambda thing: thing.extent),
        "axes": _floats(things, lambda thing: thing.axes.ravel()),
        PARENT: Column(np.array([thing.parent for thing in things], "<i4")),
    }
    return Table(name, kind, len(things), properties, columns)


def _floats(things: Sequence[Thing], numbers: Callable[[Thing], Any]) -> Column:
    return Column(np.array([numbers(thing) for thing in things], "<f4"))


def _numbers(things: Sequence[Thing]) -> Column:
    return Column(np.array([thing.number for thing in things], "<i4"))


def _embeddings(scene: LabelledScene) -> dict[str, tuple[dict[str, Any], Column]]:
    """Return the column of embeddings, a vector of zeros where an object has none; nothing where none has one."""
    lengths = {len(thing.embedding) for thing in scene.things if thing.embedding is not None}
    if not lengths:
        return {}
    if len(lengths) > 1:
        raise InputError(f"embeddings: expected vectors of one length, got {sorted(lengths)}")
    dim = lengths.pop()
    rows = np.zeros((len(scene.things), dim), "<f4")
    for row, thing in zip(rows, scene.things, strict=True):
        row[:] = 0 if thing.embedding is None else thing.embedding
    encoder = f" of {scene.encoder}" if scene.encoder else ""
    described = {"type": "SCALAR", **_FLOAT, "array": True, "count": dim, "description": f"unit vector{encoder}"}
    return {EMBEDDING: (described, Column(rows))}
