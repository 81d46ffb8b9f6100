"""Scene files as rows that are read when they are asked for: what is cut into tiles may be larger than memory."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from ..base.arrays import Flags, Matrix4, Numbers, Points, RowIds, Vector3
from ..base.contents import file_bytes
from ..errors import FormatError, InputError, placed
from ..scene.gaussians import Gaussians
from ..scene.similarity import IDENTITY, Similarity, similarity_of
from .gaussian_ply import MEANS, SCALES, activated_columns, drawn_as_marked, gaussian_rows, gaussians_of, is_compressed
from .json_files import as_kind, as_list, as_object, excerpt, read_json
from .ply import Header, Records, read_header
from .scenes import read_gaussians, scene_file
from .streamed_sog import LOD_META, chunks_of

BLOCK_ROWS = 1 << 18  # converted to doubles at once


@runtime_checkable
class Source(Protocol):
    """Some Gaussians of a scene in the coordinates of their file."""

    @property
    def name(self) -> str: ...
    def positions(self) -> Points: ...
    def sizes(self) -> Numbers:
        """Return the standard deviation along the longest axis."""

    def gaussians(self, rows: RowIds) -> Gaussians: ...


class Keep(NamedTuple):
    """A box of the world, the lower side included and the upper one not."""

    low: Vector3
    high: Vector3

    def holds(self, positions: Points) -> Flags:
        return np.all((positions >= self.low) & (positions < self.high), 1)


class _Entry(NamedTuple):
    file: str
    transform: Matrix4 | None = None
    keep: Keep | None = None


class Block(NamedTuple):
    """A source, where it stands in the world, and what of it is kept: blocks of a city are trained with a border."""

    source: Source
    place: Similarity = IDENTITY
    keep: Keep | None = None


class _MappedPly:
    """Rows of a binary PLY, read from the file when they are asked for."""

    def __init__(self, path: Path, rows: Records, header: Header) -> None:
        self.name, self._path, self._rows, self._header = path.name, path, rows, header
        self._activated = activated_columns(rows)

    def positions(self) -> Points:
        result = np.empty((len(self._rows), 3))
        for begin in range(0, len(result), BLOCK_ROWS):
            block = self._rows[begin : begin + BLOCK_ROWS]
            for axis, name in enumerate(MEANS):
                result[begin : begin + BLOCK_ROWS, axis] = block[name]
        return result

    def sizes(self) -> Numbers:
        largest = np.full(len(self._rows), -np.inf, np.float32)
        for begin in range(0, len(largest), BLOCK_ROWS):
            block = self._rows[begin : begin + BLOCK_ROWS]
            for name in [name for name in SCALES if name in (block.dtype.names or ())]:
                np.maximum(largest[begin : begin + BLOCK_ROWS], block[name], out=largest[begin : begin + BLOCK_ROWS])
        with np.errstate(over="ignore"):  # rows that are no Gaussians are told when they are read
            return largest if "scale" in self._activated else np.exp(largest)

    def gaussians(self, rows: RowIds) -> Gaussians:
        try:
            return drawn_as_marked(gaussians_of(self._rows[rows], self._activated), self._header)
        except FormatError as error:
            raise FormatError(f"{self._path}: {error}") from None


class _Whole:
    """A file that is read at once, and kept: those of other formats are small."""

    def __init__(self, path: Path, name: str = "") -> None:
        self.name, self._path = name or path.name, path

    @cached_property
    def _gaussians(self) -> Gaussians:
        return read_gaussians(self._path)

    def positions(self) -> Points:
        return self._gaussians.positions

    def sizes(self) -> Numbers:
        return self._gaussians.scales.max(1)

    def gaussians(self, rows: RowIds) -> Gaussians:
        return self._gaussians.subset(rows)


def sources_of(path: Path) -> list[Source]:
    """Return the sources of a scene file, a trained model's folder, or a streamed SOG (its folder or lod-meta.json).

    Raises: InputError: there is none. FormatError: as `read_gaussians`, at the latest when rows are read.
    """
    lod_meta = path if path.name == LOD_META else path / LOD_META
    if lod_meta.is_file():
        return [_Whole(chunk, f"{chunk.parent.name}/{chunk.name}") for chunk in chunks_of(lod_meta)]
    path = scene_file(path)
    if path.suffix.lower() != ".ply":
        return [_Whole(path)]
    content = file_bytes(path)
    try:
        header = read_header(content.data)
        if header.order == "=" or is_compressed(header):
            return [_Whole(path)]
        return [_MappedPly(path, gaussian_rows(content.data, header), header)]
    except FormatError as error:
        raise FormatError(placed(path, error)) from None


def read_blocks(path: Path) -> list[Block]:
    """Return the blocks of a city from JSON: a list of {"file", "transform", "keep"}.

    file: relative to the document. transform: 4x4, rows first, from the file's coordinates to the world's; left out:
    none. keep: {"low": [x, y, z], "high": [x, y, z]} in the world; Gaussians elsewhere are left out, so that what
    two blocks have in common is there once; left out: all are kept.

    Raises: InputError: a file that is missing. FormatError: another document.
    """
    entries = as_list(read_json(path), f"{path}: a list of blocks")
    if not entries:
        raise FormatError(f"{path}: expected a list of blocks, got an empty one")
    return [block for number, entry in enumerate(entries) for block in _blocks(entry, path, f"{path}: block {number}")]


def _blocks(value: object, path: Path, where: str) -> list[Block]:
    entry: _Entry = as_kind(value, _Entry, where)
    unknown = sorted(as_object(value, where).keys() - set(_Entry._fields))
    if unknown:
        raise FormatError(f"{where}: expected file, and maybe transform and keep, got {excerpt(unknown[0])}")
    try:
        place = IDENTITY if entry.transform is None else similarity_of(entry.transform)
    except InputError as error:
        raise FormatError(f"{where}: transform: {error}") from None
    if entry.keep is not None and not (entry.keep.low < entry.keep.high).all():
        raise FormatError(f"{where}: keep: expected low below high")
    return [Block(source, place, entry.keep) for source in sources_of(path.parent / entry.file)]


def blocks_of(paths: Sequence[Path]) -> list[Block]:
    """Return the scene files that are in the coordinates of one world already; a .json is one of `read_blocks`."""
    listed = [path for path in paths if path.suffix.lower() == ".json" and path.name not in (LOD_META, "meta.json")]
    return [
        block
        for path in paths
        for block in (read_blocks(path) if path in listed else [Block(source) for source in sources_of(path)])
    ]
