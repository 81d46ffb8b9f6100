"""Writing streamed SOG: a folder of SOG chunks at several levels of detail, named by its lod-meta.json.

Each leaf of the tree is a run of neighbouring Gaussians, and each of its levels is merged from the one before, so that
no level needs more than a leaf in memory. Chunks are filled with the runs of leaves in their order; what waits to be
written is at most a chunk of each level. A folder of tiles may therefore be of any size.

Source: developer.playcanvas.com, "The Streamed SOG Format", version 1.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Float32
from ..scene.gaussians import Gaussians, concatenated
from ..scene.labelled import LabelledScene
from ..scene.merging import coarser
from ..scene.morton import morton_order
from .field_folder import replacing_folder
from .labels import has_labels, labels_bytes
from .leaves import leaves_of
from .replacing import replacing
from .sog import OWN
from .sog_files import META
from .sog_writing import GENERATOR, LABELS, ordered_files
from .streamed_sog import LOD_META
from .tiles import Tiles
from .usd_writing import extent_of

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
    gaussians, labels = (source, b"") if isinstance(source, Tiles) else _parts(source)
    with replacing_folder(path.resolve().parent, overwrite, LOD_META) as temporary:
        writer = _Writer(temporary, chunk_rows)
        for run in _runs(gaussians, leaf_rows):
            writer.add(run)
        writer.finish(labels)


def _parts(scene: LabelledScene) -> tuple[Gaussians, bytes]:
    """Return the Gaussians with the columns that go along, and the names of the objects, empty without any."""
    return replace(scene.gaussians, extra=scene.columns), labels_bytes(scene) if has_labels(scene) else b""


def _runs(source: Gaussians | Tiles, rows: int) -> Iterator[Gaussians]:
    """Yield the finest level of each leaf of the tree, neighbours next to each other."""
    for read in leaves_of(source, rows).leaves:
        part = read()
        for begin in range(0, len(part), rows):
            yield part.subset(np.arange(begin, min(begin + rows, len(part))))


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
    leaves: list[dict[str, Any]] = field(default_factory=list)

    def add(self, run: Gaussians) -> None:
        """Add a leaf with all of its levels."""
        boxes, levels = [], {}
        for level in range(LEVELS):
            if level:
                run = coarser(run, max(1, len(run) // LEVEL_RATIO), run.extra.get("object_id")).gaussians
            run = run.subset(morton_order(run.means))
            boxes.append(extent_of(run))
            levels[str(level)] = self._placed(run, level)
        low, high = np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]
        self.leaves.append({"bound": _bound(low, high), "lods": levels})

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

    def _placed(self, run: Gaussians, level: int) -> dict[str, int]:
        """Put a run into the chunk of its level that is being filled; returns where it is there."""
        chunk = self.open_chunks.get(level) or self._begun(level)
        place = {"file": chunk.number, "offset": chunk.count, "count": len(run)}
        chunk.runs.append(run)
        self.counts[level] += len(run)
        if chunk.count >= self.chunk_rows:
            self._write(self.open_chunks.pop(level))
        return place

    def _begun(self, level: int) -> _Chunk:
        number = sum(name.startswith(f"{level}_") for name in self.filenames)
        chunk = self.open_chunks[level] = _Chunk(f"{level}_{number}", len(self.filenames))
        self.filenames.append(f"{chunk.name}/{META}")
        return chunk

    def _write(self, chunk: _Chunk) -> None:
        (self.folder / chunk.name).mkdir()
        _write_files(self.folder / chunk.name, ordered_files(_joined(chunk.runs)))


def _joined(runs: Sequence[Gaussians]) -> Gaussians:
    """Return runs of one origin as one, which keeps that origin."""
    whole = concatenated([replace(run, origin=np.zeros(3)) for run in runs])
    return replace(whole, means=np.concatenate([run.means for run in runs]), origin=runs[0].origin)


def _write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    for name, content in files.items():
        with replacing(folder / name) as file:
            file.write(content)


def _tree(leaves: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return a binary tree over leaves in their order; the box of a node is that of its children together."""
    if len(leaves) == 1:
        return leaves[0]
    children = [_tree(leaves[: len(leaves) // 2]), _tree(leaves[len(leaves) // 2 :])]
    corners = {
        end: [pick(numbers) for numbers in zip(*(child["bound"][end] for child in children), strict=True)]
        for end, pick in (("min", min), ("max", max))
    }
    return {"bound": corners, "children": children}


def _bound(low: Float32[np.ndarray, " 3"], high: Float32[np.ndarray, " 3"]) -> dict[str, list[float]]:
    ends = {"min": low, "max": high}
    return {name: [float(f"{number:.{INDEX_DIGITS}g}") for number in corner] for name, corner in ends.items()}
