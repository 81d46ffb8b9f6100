"""A scene as tiles on disk: safetensors files of neighbouring Gaussians, and a manifest with a box about each.

Rows follow a Morton curve; a tile holds a run of them, so a row of the scene is the tile's first row plus a row of
the tile. What a photo sees is loaded from the tiles in front of its camera, never the whole scene.

A scene as leaves of a tree of levels of detail: runs of neighbouring Gaussians that are read one at a time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Arrays, Numbers, Points, Vector3, Vectors
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians, ShapesDigest, drawn_alike, filled, near_plane
from ..scene.morton import morton_order
from ..scene.parted import Parted
from .activation import refuse_unwritable
from .field_folder import read_manifest, replacing_folder
from .json_files import as_document, as_fields, as_kind, excerpt, write_json, written_name
from .tensors import (
    DOCUMENT,
    check_document,
    check_seal,
    check_tensors,
    header_checksum,
    read_tensors,
    sealed,
    write_tensors,
)

TILES = "tiles.json"
FORMAT, VERSION = "drsplat tiles", 1
MAX_MANIFEST_BYTES = 64 << 20
FAINTEST = 1 / 255 * 0.999  # opacity below which nothing is drawn, and a little less
MAX_ROWS = (1 << 31) - 1
CURE = "Restore the folder from a copy, or cut the scene anew"
_SHAPES = {
    "means": ("float32", "n xyz"),
    "quats": ("float32", "n wxyz"),
    "scales": ("float32", "n xyz"),
    "opacities": ("float32", "n"),
}
_COLOURS = {"sh": ("float32", "n k xyz"), "block": ("uint16", "n"), "source_row": ("uint32", "n")}
SHAPES, COLOURS = "shapes", "colours"
_KINDS = {SHAPES: _SHAPES, COLOURS: _COLOURS}


@dataclass(frozen=True, eq=False)
class _Entry:
    name: str
    count: int
    low: Vector3
    high: Vector3
    largest: float
    crc32: Mapping[str, str]


class Tile(NamedTuple):
    """A run of rows. low, high: the box of its centres, counted from the scene's origin.

    largest: standard deviation of the largest of its Gaussians that can be seen. checksums: of its files' headers, by
    kind.
    """

    name: str
    first: int
    num_rows: int
    low: Vector3
    high: Vector3
    largest: float
    checksums: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Tiles:
    """A scene on disk. near: as `Gaussians.near` of the whole. sources: names of what it was cut from, by block.

    fingerprint: that of `gaussians()`. digest: their `ShapesDigest`. origin: that the tiles' positions are counted
    from, in the world. antialiased: as of `Gaussians`.
    """

    path: Path
    tiles: tuple[Tile, ...]
    origin: Vector3
    near: float
    digest: str
    fingerprint: str
    sources: tuple[str, ...]
    antialiased: bool = False

    def __repr__(self) -> str:
        return f"Tiles({len(self):,} Gaussians in {len(self.tiles):,} tiles, {self.fingerprint})"

    def __len__(self) -> int:
        return self.tiles[-1].first + self.tiles[-1].num_rows

    @property
    def corners(self) -> tuple[Points, Points]:
        """The lowest and the highest corner of each tile's box, counted from `origin`."""
        low, high = (np.array([getattr(tile, end) for tile in self.tiles]) for end in ("low", "high"))
        return low, high

    def shapes(self, tile: Tile) -> Gaussians:
        """Return a tile without its colours, which registration does not need. Raises: FormatError: damaged."""
        arrays = self._read(tile, SHAPES, _SHAPES)
        means, quats, widths, opacities = (arrays[name] for name in _SHAPES)
        return Gaussians(
            means, quats, widths, opacities, np.zeros((tile.num_rows, 1, 3), np.float32), origin=self.origin,
            antialiased=self.antialiased,
        )  # fmt: skip

    def tile(self, tile: Tile) -> Gaussians:
        """Return a tile with its colours. Raises: FormatError: damaged."""
        return replace(self.shapes(tile), sh=self._read(tile, COLOURS, _COLOURS)["sh"])

    def parted(self) -> Parted:
        """Return the Gaussians for queries, which read the tiles that have their rows."""
        firsts = [tile.first for tile in self.tiles]
        low, high = self.corners
        return Parted(
            np.array([*firsts, len(self)], np.int64), low, high, self.origin, self.fingerprint, self.near,
            self.antialiased, lambda number: self.tile(self.tiles[number]),
            lambda number: self.shapes(self.tiles[number]),
        )  # fmt: skip

    def gaussians(self) -> Gaussians:
        """Return the whole scene in memory; extra columns hold the block and the row that a Gaussian came from.

        Raises: FormatError: damaged.
        """
        shapes = [self.shapes(tile) for tile in self.tiles]
        colours = [self._read(tile, COLOURS, _COLOURS) for tile in self.tiles]
        most = max(part["sh"].shape[1] for part in colours)
        means, quats, widths, opacities = (np.concatenate([getattr(part, name) for part in shapes]) for name in _SHAPES)
        sh = np.concatenate([filled(part["sh"], most) for part in colours])
        origins = {name: np.concatenate([part[name] for part in colours]) for name in ("block", "source_row")}
        return Gaussians(means, quats, widths, opacities, sh, origins, self.origin, self.antialiased)

    def verify(self) -> list[str]:
        """Compare every file with its checksums, a tile at a time; return their names. Raises: FormatError: damaged."""
        check_document(self.path / TILES)
        for tile in self.tiles:
            for kind, expected in _KINDS.items():
                self._read(tile, kind, expected)
        return [TILES, *(file_name(tile, kind) for tile in self.tiles for kind in _KINDS)]

    def _read(self, tile: Tile, kind: str, expected: Mapping[str, tuple[str, str]]) -> Arrays:
        path = self.path / file_name(tile, kind)
        try:
            arrays, metadata = read_tensors(path)
        except (InputError, FormatError) as error:
            raise FormatError(f"{error}. {CURE}") from None
        if tile.checksums.get(kind) != header_checksum(metadata):
            raise FormatError(f"{path}: another file than {TILES} names, of other tiles or damaged. {CURE}")
        check_tensors(arrays, expected, str(path))
        if len(next(iter(arrays.values()))) != tile.num_rows:
            raise FormatError(f"{path}: expected {tile.num_rows} rows. {CURE}")
        return arrays


def file_name(tile: Tile, kind: str) -> str:
    """Return the name of the file that has a tile's SHAPES or COLOURS."""
    return f"{tile.name}.{kind}.safetensors"


def read_tiles(path: Path) -> Tiles:
    """Read the tiles of a folder; only the manifest is read.

    Raises: InputError: there are none. FormatError: a damaged manifest, or of a newer version.
    """
    where = str(path / TILES)
    document = read_manifest(path, TILES, "tiled scene", MAX_MANIFEST_BYTES)
    as_document(document, where, FORMAT, VERSION)
    check_seal(document, where, cure=CURE)
    tiles: list[Tile] = []
    for entry in as_kind(document.get("tiles"), tuple[_Entry, ...], f"{where}: tiles"):
        first = tiles[-1].first + tiles[-1].num_rows if tiles else 0
        if not entry.name.isalnum() or not 0 < entry.count <= MAX_ROWS - first:
            raise FormatError(
                f"{where}: expected a tile's name of letters and digits, and 1 to {MAX_ROWS:,} rows in all, got "
                f"{excerpt(entry.name)} of {entry.count}"
            )
        box = entry.low, entry.high
        tiles.append(Tile(entry.name, first, entry.count, *box, entry.largest, entry.crc32))
    if not tiles:
        raise FormatError(f"{where}: expected tiles, there are none")
    about = as_fields(
        document, where, origin=Vector3, near=float, shapes=str, scene=str, sources=tuple[str, ...],
        antialiased=bool | None,
    )  # fmt: skip
    return Tiles(
        path, tuple(tiles), about["origin"], about["near"], about["shapes"], about["scene"], about["sources"],
        bool(about["antialiased"]),
    )  # fmt: skip


class _Writer:
    """Tiles of a folder that is being made, one at a time."""

    def __init__(self, folder: Path, origin: Vector3) -> None:
        self.folder, self.origin, self.digest = folder, origin, ShapesDigest(origin)
        self.tiles: list[dict[str, object]] = []
        self.means: list[Vectors] = []
        self.opacities: list[Numbers] = []
        self.antialiased: list[bool] = []

    def add(self, part: Gaussians) -> None:
        name = f"tile{len(self.tiles):05d}"
        shapes = {key: getattr(part, key) for key in _SHAPES}
        colours = {"sh": part.sh} | {key: part.extra[key] for key in ("block", "source_row")}
        sums = {
            kind: write_tensors(self.folder / f"{name}.{kind}.safetensors", arrays)
            for kind, arrays in ((SHAPES, shapes), (COLOURS, colours))
        }
        self.digest.add(part)
        self.antialiased.append(part.antialiased)
        self.means.append(part.means)
        self.opacities.append(part.opacities)
        self.tiles.append(
            {
                "name": name,
                "count": len(part),
                "low": part.means.min(0).tolist(),
                "high": part.means.max(0).tolist(),
                "largest": float(part.scales[part.opacities >= FAINTEST].max(initial=0.0)),
                DOCUMENT: sums,
            }
        )

    def manifest(self, sources: Sequence[str]) -> dict[str, object]:
        """Return the manifest; its fingerprint and near plane need all positions, 16 bytes a Gaussian."""
        means, antialiased = np.concatenate(self.means), drawn_alike(self.antialiased)
        bare = np.zeros((len(means), 4), np.float32)
        whole = Gaussians(
            means, bare, bare[:, :3], np.concatenate(self.opacities), np.zeros((len(means), 1, 3), np.float32),
            origin=self.origin, antialiased=antialiased,
        )  # fmt: skip
        return {
            "format": FORMAT, "version": VERSION, "scene": whole.fingerprint, "num_gaussians": len(means),
            "shapes": self.digest.text(), "near": near_plane(means, whole.opacities), "origin": self.origin.tolist(),
            "sources": list(map(written_name, sources)), **({"antialiased": True} if antialiased else {}),
            "tiles": self.tiles,
        }  # fmt: skip


def write_tiles(
    path: Path, parts: Iterator[Gaussians], origin: Vector3, sources: Sequence[str], overwrite: bool
) -> Tiles:
    """Write tiles as they come, all or none. parts: counted from `origin`, with the columns block and source_row.

    Raises: InputError: as `replacing_folder`; parts of which some are drawn antialiased.
    """
    with replacing_folder(path, overwrite, TILES) as folder:
        writer = _Writer(folder, origin)
        for part in parts:
            writer.add(part)
        write_json(folder / TILES, sealed(writer.manifest(sources)))
    return read_tiles(path)


Leaf = Callable[[], Gaussians]
"""Reads the Gaussians of a leaf."""


def leaves_of(source: Gaussians | Tiles, rows: int) -> tuple[list[Leaf], Vector3]:
    """Split a scene into leaves, neighbours next to each other, and return the middle of all centres' box in the world.

    rows: of a leaf at most, of a scene that is not cut into tiles already.

    Raises: InputError: no Gaussians, or some that no file could give back.
    """
    if isinstance(source, Tiles):
        low, high = np.min([t.low for t in source.tiles], axis=0), np.max([t.high for t in source.tiles], axis=0)
        return [partial(source.tile, tile) for tile in source.tiles], source.origin + (low + high) / 2
    refuse_unwritable(source)
    order = morton_order(source.means.astype(np.float64))
    runs = [order[begin : begin + rows] for begin in range(0, len(order), rows)]
    middle = source.origin + (source.means.min(0).astype(np.float64) + source.means.max(0)) / 2
    return [partial(source.subset, run) for run in runs], middle
