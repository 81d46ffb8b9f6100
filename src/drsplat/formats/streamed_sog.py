"""SuperSplat's streamed SOG: a folder of SOG chunks at several levels of detail, named by its lod-meta.json.

Level 0 is the finest; coarser ones show the same things with fewer Gaussians. `filenames` are those of the chunks'
meta.json, relative to the folder; the tree's leaves say which rows of which chunk are of a level. The chunk of the
environment (sky and what is far away), where there is one, comes last and belongs to every level. The names of objects
that drsplat writes lie beside, in a file that "drsplat" names.

Source: developer.playcanvas.com, "The Streamed SOG Format", version 1.

Writing streamed SOG: a folder of SOG chunks at several levels of detail, named by its lod-meta.json.

Each leaf of the tree is a run of neighbouring Gaussians, and each of its levels is merged from the one before, so that
no level needs more than a leaf in memory. Chunks are filled with the runs of leaves in their order; what waits to be
written is at most a chunk of each level. A folder of tiles may therefore be of any size.

Source: developer.playcanvas.com, "The Streamed SOG Format", version 1.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..base.contents import Document
from ..errors import FormatError
from ..scene.gaussians import Gaussians, concatenated
from ..scene.labelled import LabelledScene
from ..scene.merging import coarser
from ..scene.morton import morton_order
from .field_folder import replacing_folder
from .json_files import as_fields, as_kind, excerpt, read_json
from .labels import Labels, has_labels, labels_bytes, parse_labels
from .replacing import replacing
from .sog import META, OWN, beside, folder_member, read_unpacked_sog
from .sog_writing import GENERATOR, LABELS, ordered_files
from .tiles import Tiles, leaves_of
from .usd_writing import extent_of

LOD_META = "lod-meta.json"
MAX_TREE_DEPTH = 64  # a million chunks of two branches a node need 20
MAX_LEVELS = 256


@dataclass(frozen=True)
class _Run:
    file: int
    count: int = 0


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
            if not name.isdecimal() or len(name) > 3 or int(name) >= MAX_LEVELS:
                raise FormatError(
                    f"{lod_meta}: tree: lods: expected levels from 0 to {MAX_LEVELS - 1}, got {excerpt(name)}"
                )
            counts[int(name)] += run.count
    return [counts[level] for level in range(max(counts, default=-1) + 1)]


def chunks_of(lod_meta: Path, level: int = 0) -> list[Path]:
    """Return the meta.json of each chunk with Gaussians of a level, in the order of the tree, and the environment's.

    Raises: FormatError: another version, a tree without chunks of the level, a chunk of several levels, or one that
    leads out of the folder.
    """
    document = _document(lod_meta)
    names = as_kind(document.get("filenames"), tuple[str, ...], f"{lod_meta}: filenames")
    leaves = _leaves(document.get("tree"), str(lod_meta))
    named = [(name, run.file) for leaf in leaves for name, run in leaf.items()]
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


def _document(lod_meta: Path) -> Document:
    document = read_json(lod_meta)
    if not isinstance(document, dict) or document.get("version") != 1 or isinstance(document.get("version"), bool):
        version = document.get("version") if isinstance(document, dict) else None
        raise FormatError(f"{lod_meta}: expected version 1 of a streamed SOG, got {excerpt(version)}: export it again")
    return document


def _leaves(root: object, where: str) -> Iterator[dict[str, _Run]]:
    """Yield the levels of each leaf, left to right."""
    waiting: list[tuple[object, int]] = [(root, 0)]
    while waiting:
        node, depth = waiting.pop()
        inner = as_fields(node, f"{where}: tree", lods=dict[str, _Run] | None, children=list[object] | None)
        levels: dict[str, _Run] = inner["lods"] or {}
        if depth > MAX_TREE_DEPTH or any(min(run.file, run.count) < 0 for run in levels.values()):
            raise FormatError(f"{where}: tree: expected nodes, at most {MAX_TREE_DEPTH} deep, of 0 or more Gaussians")
        yield levels
        waiting += [(child, depth + 1) for child in reversed(inner["children"] or ())]


def _inside(lod_meta: Path, name: object) -> Path:
    path = beside(lod_meta, name)
    if path.name != META:
        raise FormatError(f"{lod_meta}: expected the path of a chunk's {META} in this folder, got {excerpt(name)}")
    return path


VERSION = 1
LEVELS = 4
LEVEL_RATIO = 4  # Gaussians of a level for each of the next
LEAF_ROWS = 1 << 14
CHUNK_ROWS = 1 << 17
INDEX_DIGITS = 7  # of numbers in the index


def write_streamed_sog(
    path: Path,
    source: LabelledScene | Tiles,
    overwrite: bool = False,
    *,
    leaf_rows: int = LEAF_ROWS,
    chunk_rows: int = CHUNK_ROWS,
) -> None:
    """Write a scene as a streamed SOG; all of it or nothing.

    Args:
        path: DIR/lod-meta.json; DIR gets it and a folder for each chunk.
        source: a scene with its objects, which are never merged with each other; or a folder of tiles, one of which is
            in memory at a time.
        overwrite: replaces a streamed SOG that is there.
        leaf_rows: Gaussians of a leaf of the tree, for each of which a viewer chooses a level.
        chunk_rows: Gaussians of a chunk from which on it is written.

    Raises: InputError: no Gaussians, or some that no file could give back; DIR exists and not `overwrite`.
    FormatError: damaged tiles.
    """
    labels, finest = b"", source if isinstance(source, Tiles) else replace(source.gaussians, extra=source.columns)
    if isinstance(source, LabelledScene) and has_labels(source):
        labels = labels_bytes(source)
    with replacing_folder(path.resolve().parent, overwrite, LOD_META) as temporary:
        writer = _Writer(temporary, chunk_rows)
        for read in leaves_of(finest, leaf_rows)[0]:
            part = read()
            for begin in range(0, len(part), leaf_rows):
                writer.add(part.subset(np.arange(begin, min(begin + leaf_rows, len(part)))))
        writer.finish(labels)


@dataclass
class _Chunk:
    """A file that is being filled with runs of one level. number: its place in `filenames`."""

    name: str
    number: int
    runs: list[Gaussians] = field(default_factory=list)

    @property
    def count(self) -> int:
        return sum(map(len, self.runs))


@dataclass
class _Writer:
    """A folder that is being filled, leaf by leaf."""

    folder: Path
    chunk_rows: int
    filenames: list[str] = field(default_factory=list)
    open_chunks: dict[int, _Chunk] = field(default_factory=dict)
    counts: list[int] = field(default_factory=lambda: [0] * LEVELS)
    leaves: list[Document] = field(default_factory=list)

    def add(self, run: Gaussians) -> None:
        """Add a leaf with all of its levels."""
        boxes, levels = [], {}
        for level in range(LEVELS):
            if level:
                run = coarser(run, max(1, len(run) // LEVEL_RATIO), run.extra.get("object_id")).gaussians
            run = run.subset(morton_order(run.means))
            boxes.append(extent_of(run))
            # into the chunk of its level that is being filled
            chunk = self.open_chunks.get(level)
            if chunk is None:
                number = sum(name.startswith(f"{level}_") for name in self.filenames)
                chunk = self.open_chunks[level] = _Chunk(f"{level}_{number}", len(self.filenames))
                self.filenames.append(f"{chunk.name}/{META}")
            levels[str(level)] = {"file": chunk.number, "offset": chunk.count, "count": len(run)}
            chunk.runs.append(run)
            self.counts[level] += len(run)
            if chunk.count >= self.chunk_rows:
                self._write(self.open_chunks.pop(level))
        ends = {"min": np.min(boxes, axis=0)[0], "max": np.max(boxes, axis=0)[1]}
        bound = {name: [float(f"{number:.{INDEX_DIGITS}g}") for number in corner] for name, corner in ends.items()}
        self.leaves.append({"bound": bound, "lods": levels})

    def finish(self, labels: bytes) -> None:
        """Write what is left, the index, and the names of the objects beside it."""
        for chunk in self.open_chunks.values():
            self._write(chunk)
        document = {
            "version": VERSION,
            "asset": {"generator": GENERATOR},
            "count": sum(self.counts),
            "counts": self.counts,
            "lodLevels": LEVELS,
            "filenames": self.filenames,
            **({OWN: {"labels": LABELS}} if labels else {}),
            "tree": _tree(self.leaves),
        }
        files = {LOD_META: json.dumps(document, separators=(",", ":")).encode()}
        _write_files(self.folder, files | ({LABELS: labels} if labels else {}))

    def _write(self, chunk: _Chunk) -> None:
        (self.folder / chunk.name).mkdir()
        whole = concatenated([replace(run, origin=np.zeros(3)) for run in chunk.runs])
        means = np.concatenate([run.means for run in chunk.runs])  # of one origin, which the whole keeps
        _write_files(self.folder / chunk.name, ordered_files(replace(whole, means=means, origin=chunk.runs[0].origin)))


def _write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, content in files.items():
        with replacing(folder / name) as file:
            file.write(content)


def _tree(leaves: Sequence[Document]) -> Document:
    """Return a binary tree over leaves in their order; the box of a node is that of its children together."""
    if len(leaves) == 1:
        return leaves[0]
    children = [_tree(leaves[: len(leaves) // 2]), _tree(leaves[len(leaves) // 2 :])]
    corners = {
        end: [pick(numbers) for numbers in zip(*(child["bound"][end] for child in children), strict=True)]
        for end, pick in (("min", min), ("max", max))
    }
    return {"bound": corners, "children": children}
