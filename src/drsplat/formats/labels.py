"""Names and boxes of objects as JSON, for files of other formats in which each Gaussian has the number of its object.

A SOG keeps them in a file beside its pictures, an SPZ of version 4 in an extension, which other readers step over, and
a PLY in a file beside it.
Embeddings and annotations do not go along.
"""

import json
from dataclasses import dataclass

import numpy as np

from ..base.arrays import Matrix3, Vector3
from ..errors import FormatError
from ..scene.labelled import LabelledScene, Thing
from .json_files import as_document, as_kind, as_text, document_in

FORMAT, VERSION = "drsplat objects", 1
NO_GROUP = -1
NAMES_SUFFIX = ".objects.json"
"""Ending of the names beside NAME.ply, whose columns say which object is whose."""


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of a file: the objects of its Gaussians. query: text that the relevancy is of, empty for none."""

    things: tuple[Thing, ...] = ()
    groups: tuple[Thing, ...] = ()
    query: str = ""


def has_labels(scene: LabelledScene) -> bool:
    """Return whether there is anything to write beside the Gaussians."""
    return bool(scene.things or scene.groups) or scene.object_of is not None or scene.relevancy is not None


def labels_bytes(scene: LabelledScene) -> bytes:
    """Encode the names and boxes of a scene's objects and groups as JSON."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "query": scene.query,
        "objects": [_entry(thing) for thing in scene.things],
        "groups": [_entry(thing) for thing in scene.groups],
    }
    return json.dumps(document, ensure_ascii=True, separators=(",", ":")).encode()


def parse_labels(content: bytes, where: str) -> Labels:
    """Decode what `labels_bytes` encodes. Raises: FormatError: other JSON, or numbers that are no boxes."""
    document = as_document(document_in(content, where), where, FORMAT, VERSION)
    groups = _things(document.get("groups", []), f"{where}: groups", 0)
    things = _things(document.get("objects"), f"{where}: objects", len(groups))
    return Labels(things, groups, as_text(document.get("query", ""), f"{where}: query"))


def _entry(thing: Thing) -> dict[str, object]:
    return {
        "name": thing.name,
        "score": float(thing.score),
        **{name: np.asarray(getattr(thing, name), np.float64).tolist() for name in ("center", "extent", "axes")},
        **({} if thing.parent == NO_GROUP else {"parent": int(thing.parent)}),
        **({} if thing.number < 0 else {"number": thing.number}),
    }


def _things(entries: object, where: str, groups: int) -> tuple[Thing, ...]:
    things: tuple[Thing, ...] = as_kind(entries, tuple[_thing, ...], where)  # type: ignore[valid-type]
    for number, thing in enumerate(things):
        if not NO_GROUP <= thing.parent < groups:
            raise FormatError(f"{where}: {number}: parent: expected -1 to {groups - 1}, got {thing.parent}")
    return things


def _thing(
    name: str, score: float, center: Vector3, axes: Matrix3, extent: Vector3, parent: int = NO_GROUP, number: int = -1
) -> Thing:
    return Thing(name, score, center, axes, extent, parent, number=number)
