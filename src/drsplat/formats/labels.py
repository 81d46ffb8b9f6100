"""Names and boxes of objects as JSON, for files of other formats in which each Gaussian has the number of its object.

A SOG keeps them in a file beside its pictures, an SPZ of version 4 in an extension, which other readers step over, and
a PLY in a file beside it.
Embeddings and annotations do not go along.
"""

import json
from dataclasses import dataclass
from typing import Any

from ..errors import FormatError
from ..scene.labelled import LabelledScene, Thing
from .json_files import as_count, as_matrix, as_number, as_vector, excerpt, is_text

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
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{where}: expected JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise FormatError(f"{where}: expected '{FORMAT}' of version {VERSION}, got {excerpt(document)}")
    query = document.get("query", "")
    if not is_text(query) and query != "":
        raise FormatError(f"{where}: query: expected a text, got {excerpt(query)}")
    groups = _things(document.get("groups", []), f"{where}: groups", 0)
    return Labels(_things(document.get("objects"), f"{where}: objects", len(groups)), groups, str(query))


def _entry(thing: Thing) -> dict[str, object]:
    return {
        "name": thing.name,
        "score": float(thing.score),
        "center": [float(x) for x in thing.center],
        "extent": [float(x) for x in thing.extent],
        "axes": [[float(x) for x in row] for row in thing.axes],
        **({} if thing.parent == NO_GROUP else {"parent": int(thing.parent)}),
        **({} if thing.number < 0 else {"number": thing.number}),
    }


def _things(entries: object, where: str, groups: int) -> tuple[Thing, ...]:
    if not isinstance(entries, list):
        raise FormatError(f"{where}: expected a list, got {excerpt(entries)}")
    return tuple(_thing(entry, f"{where}: {number}", groups) for number, entry in enumerate(entries))


def _thing(entry: Any, where: str, groups: int) -> Thing:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
        raise FormatError(f"{where}: expected an object with a name, got {excerpt(entry)}")
    parent = as_count(entry.get("parent", NO_GROUP), f"{where}: parent")
    if not NO_GROUP <= parent < max(groups, 0):
        raise FormatError(f"{where}: parent: expected -1 to {groups - 1}, got {parent}")
    return Thing(
        entry["name"],
        as_number(entry.get("score"), f"{where}: score"),
        as_vector(entry.get("center"), 3, f"{where}: center"),
        as_matrix(entry.get("axes"), 3, 3, f"{where}: axes"),
        as_vector(entry.get("extent"), 3, f"{where}: extent"),
        parent,
        number=as_count(entry["number"], f"{where}: number") if "number" in entry else -1,
    )
