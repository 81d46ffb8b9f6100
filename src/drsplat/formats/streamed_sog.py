"""SuperSplat's streamed SOG: a folder of SOG chunks at several levels of detail, named by its lod-meta.json.

Only the finest level is read: coarser ones show the same things with fewer Gaussians. `filenames` are those of the
chunks' meta.json, relative to the folder; the tree's leaves say which rows of which chunk are of a level. The chunk
of the environment (sky and what is far away), where there is one, comes last.

Source: developer.playcanvas.com, "The Streamed SOG Format", version 1.
"""

from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FormatError
from .json_files import as_count, is_text, read_json, shown
from .sog_files import META

LOD_META = "lod-meta.json"
FINEST = "0"
DEEPEST = 64  # of the tree; a million chunks of two branches a node need 20


def finest_chunks(lod_meta: Path) -> list[Path]:
    """Return the meta.json of each chunk of the finest level, in the order of the tree, and the environment's.

    Raises: FormatError: another version, a tree that names no chunk, names one twice or leads out of the folder, or
    chunks that hold more than one level.
    """
    document = read_json(lod_meta)
    if not isinstance(document, dict) or document.get("version") != 1 or isinstance(document.get("version"), bool):
        version = document.get("version") if isinstance(document, dict) else None
        raise FormatError(f"{lod_meta}: expected version 1 of a streamed SOG, got {shown(version)}: export it again")
    names = document.get("filenames")
    if not isinstance(names, list) or not all(map(is_text, names)):
        raise FormatError(f"{lod_meta}: filenames: expected a list of names, got {shown(names)}")
    chunks = dict.fromkeys(_leaves(document.get("tree"), str(lod_meta)))
    if not chunks:
        raise FormatError(f"{lod_meta}: the tree names no chunk of level {FINEST}, the finest")
    if max(chunks) >= len(names):
        raise FormatError(f"{lod_meta}: the tree names chunk {max(chunks)}, there are {len(names)}")
    paths = [_inside(lod_meta, names[number]) for number in chunks]
    environment = document.get("environment")
    return paths + ([] if environment is None else [_inside(lod_meta, environment)])


def _leaves(root: object, where: str) -> Iterator[int]:
    """Numbers of the chunks of the finest level, left to right."""
    waiting: list[tuple[object, int]] = [(root, 0)]
    while waiting:
        node, depth = waiting.pop()
        if not isinstance(node, dict) or depth > DEEPEST:
            raise FormatError(f"{where}: tree: expected nodes, at most {DEEPEST} deep, got {shown(node)}")
        levels: Any = node.get("lods", {})
        if not isinstance(levels, dict):
            raise FormatError(f"{where}: tree: lods: expected an object, got {shown(levels)}")
        if FINEST in levels:
            finest = levels[FINEST]
            number = as_count(finest.get("file") if isinstance(finest, dict) else None, f"{where}: tree: lods: file")
            if number < 0:
                raise FormatError(f"{where}: tree: lods: file: expected 0 or more, got {number}")
            yield number
        children: Any = node.get("children", [])
        if not isinstance(children, list):
            raise FormatError(f"{where}: tree: children: expected a list, got {shown(children)}")
        waiting += [(child, depth + 1) for child in reversed(children)]


def _inside(lod_meta: Path, name: object) -> Path:
    path = PurePosixPath(name) if isinstance(name, str) else PurePosixPath("/")
    if path.is_absolute() or ".." in path.parts or path.name != META:
        raise FormatError(f"{lod_meta}: expected the path of a chunk's {META} in this folder, got {shown(name)}")
    return lod_meta.parent / path
