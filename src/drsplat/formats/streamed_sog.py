"""SuperSplat's streamed SOG: a folder of SOG chunks at several levels of detail, named by its lod-meta.json.

Level 0 is the finest; coarser ones show the same things with fewer Gaussians. `filenames` are those of the chunks'
meta.json, relative to the folder; the tree's leaves say which rows of which chunk are of a level. The chunk of the
environment (sky and what is far away), where there is one, comes last and belongs to every level. The names of objects
that drsplat writes lie beside, in a file that "drsplat" names.

Source: developer.playcanvas.com, "The Streamed SOG Format", version 1.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import FormatError
from ..scene.gaussians import Gaussians, concatenated
from .json_files import as_count, excerpt, is_text, read_json
from .labels import Labels, parse_labels
from .sog import OWN, read_unpacked_sog
from .sog_files import META, beside, folder_member

LOD_META = "lod-meta.json"
MAX_TREE_DEPTH = 64  # a million chunks of two branches a node need 20
MAX_LEVELS = 256


def read_streamed_sog(lod_meta: Path, level: int = 0) -> Gaussians:
    """Read one level of a streamed SOG, 0 for the finest, and its environment.

    Raises: FormatError: as `chunks_of`, or a damaged chunk.
    """
    return concatenated([read_unpacked_sog(chunk) for chunk in chunks_of(lod_meta, level)])


def read_streamed_labels(lod_meta: Path) -> Labels:
    """Return the names and boxes of objects that drsplat wrote beside; none in files of other programs.

    Raises: FormatError: labels that are none, or a file elsewhere.
    """
    own = _document(lod_meta).get(OWN)
    name = own.get("labels") if isinstance(own, dict) else None
    return Labels() if name is None else parse_labels(folder_member(lod_meta.parent)(str(name)), str(name))


def counts_of_levels(lod_meta: Path) -> list[int]:
    """Return the number of Gaussians in each level, the finest first, as the leaves of the tree say.

    Raises: FormatError: as `chunks_of`.
    """
    counts: Counter[int] = Counter()
    for levels in _leaves(_document(lod_meta).get("tree"), str(lod_meta)):
        for name, run in levels.items():
            counts[_level(name, lod_meta)] += _number(run, "count", str(lod_meta))
    return [counts[level] for level in range(max(counts, default=-1) + 1)]


def chunks_of(lod_meta: Path, level: int = 0) -> list[Path]:
    """Return the meta.json of each chunk with Gaussians of a level, in the order of the tree, and the environment's.

    Raises: FormatError: another version, a tree without chunks of the level, a chunk of several levels, or one that
    leads out of the folder.
    """
    document = _document(lod_meta)
    names = document.get("filenames")
    if not isinstance(names, list) or not all(map(is_text, names)):
        raise FormatError(f"{lod_meta}: filenames: expected a list of names, got {excerpt(names)}")
    named = [
        (name, _number(run, "file", str(lod_meta)))
        for leaf in _leaves(document.get("tree"), str(lod_meta))
        for name, run in leaf.items()
    ]
    chunks = dict.fromkeys(number for name, number in named if name == str(level))
    if not chunks:
        raise FormatError(f"{lod_meta}: the tree names no chunk of level {level}; 0 is the finest")
    shared = sorted(chunks.keys() & {number for name, number in named if name != str(level)})
    if shared:
        raise FormatError(f"{lod_meta}: chunk {shared[0]} holds several levels; expected one level in each chunk")
    if max(chunks) >= len(names):
        raise FormatError(f"{lod_meta}: the tree names chunk {max(chunks)}, there are {len(names)}")
    paths = [_inside(lod_meta, names[number]) for number in chunks]
    environment = document.get("environment")
    return paths + ([] if environment is None else [_inside(lod_meta, environment)])


def _document(lod_meta: Path) -> dict[str, Any]:
    document = read_json(lod_meta)
    if not isinstance(document, dict) or document.get("version") != 1 or isinstance(document.get("version"), bool):
        version = document.get("version") if isinstance(document, dict) else None
        raise FormatError(f"{lod_meta}: expected version 1 of a streamed SOG, got {excerpt(version)}: export it again")
    return document


def _leaves(root: object, where: str) -> Iterator[dict[str, Any]]:
    """Yield the levels of each leaf, left to right."""
    waiting: list[tuple[object, int]] = [(root, 0)]
    while waiting:
        node, depth = waiting.pop()
        if not isinstance(node, dict) or depth > MAX_TREE_DEPTH:
            raise FormatError(f"{where}: tree: expected nodes, at most {MAX_TREE_DEPTH} deep, got {excerpt(node)}")
        levels: Any = node.get("lods", {})
        if not isinstance(levels, dict):
            raise FormatError(f"{where}: tree: lods: expected an object, got {excerpt(levels)}")
        yield levels
        children: Any = node.get("children", [])
        if not isinstance(children, list):
            raise FormatError(f"{where}: tree: children: expected a list, got {excerpt(children)}")
        waiting += [(child, depth + 1) for child in reversed(children)]


def _number(run: object, key: str, where: str) -> int:
    number = as_count(run.get(key) if isinstance(run, dict) else None, f"{where}: tree: lods: {key}")
    if number < 0:
        raise FormatError(f"{where}: tree: lods: {key}: expected 0 or more, got {number}")
    return number


def _level(name: str, lod_meta: Path) -> int:
    if not name.isdecimal() or len(name) > 3 or int(name) >= MAX_LEVELS:
        raise FormatError(f"{lod_meta}: tree: lods: expected levels from 0 to {MAX_LEVELS - 1}, got {excerpt(name)}")
    return int(name)


def _inside(lod_meta: Path, name: object) -> Path:
    path = beside(lod_meta, name)
    if path.name != META:
        raise FormatError(f"{lod_meta}: expected the path of a chunk's {META} in this folder, got {excerpt(name)}")
    return path
