"""LCC2, the format of XGRIDS' scanners: a JSON index (`.lcc2`) of a tree of regions, and chunks that are SOG or SPZ.

Each node below the root holds its region at one level of detail, and its children hold it at the next finer one, so
that the leaves together are the scene at its finest; only they are read. A chunk may be of several nodes. The
environment (sky and what is far away), where its file is there, comes last. Older files have other names for the same.

Axes of the file have z up; what is read is turned to those of a PLY, y down, as splat-transform turns it.

Source: developer.playcanvas.com, "The LCC2 Format"; the names and axes that splat-transform 2.7 reads (no description
of XGRIDS' own says them).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..base.contents import file_bytes
from ..errors import FormatError
from ..scene.gaussians import Gaussians, concatenated
from ..scene.similarity import similarity_of
from .json_files import as_count, excerpt, is_text, read_json
from .sog import parse_sog
from .sog_files import beside
from .spz import parse_spz

SUFFIX = ".lcc2"
MAX_TREE_DEPTH = 64
PARSERS = {".sog": parse_sog, ".spz": parse_spz}
PLY_FROM_LCC = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def read_lcc2(path: Path) -> Gaussians:
    """Read the finest level of a scene and its environment, in the order of the chunks.

    Raises: FormatError: another document, chunks that are missing, damaged, elsewhere or of another length than told.
    """
    root, names, kind = _index(read_json(path), path)
    environment = _environment(root, str(path))
    counts: dict[int, list[int]] = {}
    for node in _leaves(root, str(path)):
        _note(node, counts, str(path))
    counts.pop(-1 if environment is None else environment, None)
    if not counts:
        raise FormatError(f"{path}: no leaf of the tree has splats")
    parts = [_chunk(path, names, number, kind, counts[number]) for number in sorted(counts)]
    if environment is not None and beside(path, _name(path, names, environment)).is_file():
        parts.append(_chunk(path, names, environment, kind, []))
    return similarity_of(PLY_FROM_LCC).moved(concatenated(parts))


def _index(document: Any, path: Path) -> tuple[dict[str, Any], list[str], str]:
    """Return the root of the tree, the names of the chunks and their suffix."""
    root = document.get("root") if isinstance(document, dict) else None
    if not isinstance(root, dict):
        raise FormatError(f"{path}: expected an LCC2 index with a root, got {excerpt(document)}")
    is_old = "splatFiles" not in root
    names = root.get("files" if is_old else "splatFiles")
    if not isinstance(names, list) or not all(map(is_text, names)):
        raise FormatError(f"{path}: root: splatFiles: expected a list of names, got {excerpt(names)}")
    kind = document.get("splatType", ".sog")
    if not isinstance(kind, str) or kind not in PARSERS:
        raise FormatError(f"{path}: splatType: expected .sog or .spz, got {excerpt(kind)}")
    if is_old:  # whose names newer files have in another way
        names = [name.removeprefix("/").removesuffix(".sog") + ".sog" for name in names]
    return root, names, kind


def _environment(root: dict[str, Any], where: str) -> int | None:
    data = root.get("data")
    entry = data.get("env") if isinstance(data, dict) else None
    return None if entry is None else _count(entry, "name", f"{where}: root: env")


def _leaves(root: dict[str, Any], where: str) -> Iterator[dict[str, Any]]:
    """Yield the nodes below the root that have no children."""
    waiting = [(child, 1) for child in _children(root, where)]
    while waiting:
        node, depth = waiting.pop()
        if not isinstance(node, dict) or depth > MAX_TREE_DEPTH:
            raise FormatError(f"{where}: expected nodes, at most {MAX_TREE_DEPTH} deep, got {excerpt(node)}")
        children = _children(node, where)
        if not children:
            yield node
        waiting += [(child, depth + 1) for child in children]


def _children(node: dict[str, Any], where: str) -> list[Any]:
    found = node.get("child") or []
    if not isinstance(found, list | dict):
        raise FormatError(f"{where}: child: expected a list or an object of nodes, got {excerpt(found)}")
    return list(found.values()) if isinstance(found, dict) else found


def _note(node: dict[str, Any], counts: dict[int, list[int]], where: str) -> None:
    """Add the chunk of a leaf, and how many of its rows are told to be the leaf's."""
    data = node.get("data")
    entry = data.get("3dgs") if isinstance(data, dict) else None
    if entry is not None:
        own = counts.setdefault(_count(entry, "name", f"{where}: 3dgs"), [])
        own.append(_count(entry, "count", f"{where}: 3dgs") if "count" in entry else -1)


def _count(entry: Any, key: str, where: str) -> int:
    number = as_count(entry.get(key) if isinstance(entry, dict) else None, f"{where}: {key}")
    if number < 0:
        raise FormatError(f"{where}: {key}: expected 0 or more, got {number}")
    return number


def _name(path: Path, names: list[str], number: int) -> str:
    if number >= len(names):
        raise FormatError(f"{path}: the tree names chunk {number}, there are {len(names)}")
    return names[number]


def _chunk(path: Path, names: list[str], number: int, kind: str, counts: list[int]) -> Gaussians:
    """Read a chunk, all of whose rows are those of its leaves, where these say how many they have."""
    name = _name(path, names, number)
    file = beside(path, name)
    if not file.is_file():
        raise FormatError(f"{path}: there is no chunk '{name}' beside it: name the index in its whole folder")
    try:
        gaussians = PARSERS[kind](file_bytes(file).data)
    except FormatError as error:
        raise FormatError(f"{name}: {error}") from None
    if counts and -1 not in counts and sum(counts) != len(gaussians):
        raise FormatError(f"{name}: {len(gaussians)} Gaussians, the tree says {sum(counts)}")
    return gaussians
