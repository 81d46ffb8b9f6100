"""A scene as tiles on disk: safetensors files of neighbouring Gaussians, and a manifest with a box about each.

Rows follow a Morton curve; a tile holds a run of them, so a row of the scene is the tile's first row plus a row of
the tile. What a photo sees is loaded from the tiles in front of its camera, never the whole scene.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..base.arrays import Float32, Float64
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians, ShapesDigest, drawn_alike, filled
from ..scene.parted import Parted
from ..scene.placing import near_plane
from .checksums import DOCUMENT, check_document, check_seal, header_checksum, sealed
from .field_folder import read_manifest, replacing_folder
from .json_files import as_count, as_number, as_vector, excerpt, is_text, written_name
from .replacing import replacing
from .tensors import check_tensors, read_tensors, write_tensors

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


class Tile(NamedTuple):
    """A run of rows. low, high: the box of its centres, counted from the scene's origin.

    largest: standard deviation of the largest of its Gaussians that can be seen. checksums: of its files' headers, by
    kind; none in manifests of older versions.
    """

    name: str
    first: int
    num_rows: int
    low: Float64[np.ndarray, " 3"]
    high: Float64[np.ndarray, " 3"]
    largest: float
    checksums: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Tiles:
    """A scene on disk. near: as `Gaussians.near` of the whole. sources: names of what it was cut from, by block.

    fingerprint: that of `gaussians()`. digest: their `ShapesDigest`. origin: that the tiles' positions are counted
    from, in the world. antialiased: as of `Gaussians`.
    """

    path: Path
    tiles: tuple[Tile, ...]
    origin: Float64[np.ndarray, " 3"]
    near: float
    digest: str
    fingerprint: str
    sources: tuple[str, ...]
    antialiased: bool = False

    def __repr__(self) -> str:
        return f"Tiles({len(self):,} Gaussians in {len(self.tiles):,} tiles, {self.fingerprint})"

    def __len__(self) -> int:
        return self.tiles[-1].first + self.tiles[-1].num_rows

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
        low, high = (np.array([getattr(tile, end) for tile in self.tiles]) for end in ("low", "high"))
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

    def _read(self, tile: Tile, kind: str, expected: Mapping[str, tuple[str, str]]) -> dict[str, np.ndarray]:
        path = self.path / file_name(tile, kind)
        try:
            arrays, metadata = read_tensors(path)
        except (InputError, FormatError) as error:
            raise FormatError(f"{error}. {CURE}") from None
        if tile.checksums.get(kind, header_checksum(metadata)) != header_checksum(metadata):
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
    if document.get("format") != FORMAT or document.get("version") != VERSION:
        raise FormatError(f"{where}: expected '{FORMAT}' of version {VERSION}, got {excerpt(document.get('version'))}")
    check_seal(document, where, cure=CURE)
    listed, sources = document.get("tiles"), document.get("sources")
    if not isinstance(listed, list) or not listed or not isinstance(sources, list) or not all(map(is_text, sources)):
        raise FormatError(f"{where}: expected lists of tiles and sources")
    tiles: list[Tile] = []
    for entry in listed:
        tiles.append(_tile(entry, tiles[-1].first + tiles[-1].num_rows if tiles else 0, where))
    return Tiles(
        path, tuple(tiles), as_vector(document.get("origin"), 3, f"{where}: origin"),
        as_number(document.get("near"), f"{where}: near"), str(document.get("shapes")), str(document.get("scene")),
        tuple(sources), document.get("antialiased") is True,
    )  # fmt: skip


def _tile(entry: object, first: int, where: str) -> Tile:
    if not isinstance(entry, dict):
        raise FormatError(f"{where}: expected a tile, got {excerpt(entry)}")
    name = entry.get("name")
    if not isinstance(name, str) or not name.isalnum():
        raise FormatError(f"{where}: expected a tile's name of letters and digits, got {excerpt(name)}")
    count = as_count(entry.get("count"), f"{where}: count")
    if not 0 < count <= MAX_ROWS - first:
        raise FormatError(f"{where}: tile {name}: expected 1 to {MAX_ROWS:,} rows in all, got {count}")
    low, high = (as_vector(entry.get(end), 3, f"{where}: {end}") for end in ("low", "high"))
    sums = entry.get(DOCUMENT, {})
    if not isinstance(sums, dict) or not all(map(is_text, sums.values())):
        raise FormatError(f"{where}: tile {name}: expected the checksums of its files, got {excerpt(sums)}")
    return Tile(name, first, count, low, high, as_number(entry.get("largest"), f"{where}: largest"), sums)


class _Writer:
    """Tiles of a folder that is being made, one at a time."""

    def __init__(self, folder: Path, origin: Float64[np.ndarray, " 3"]) -> None:
        self.folder, self.origin, self.digest = folder, origin, ShapesDigest(origin)
        self.tiles: list[dict[str, object]] = []
        self.means: list[Float32[np.ndarray, "n 3"]] = []
        self.opacities: list[Float32[np.ndarray, " n"]] = []
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
                "low": part.means.min(axis=0).tolist(),
                "high": part.means.max(axis=0).tolist(),
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
    path: Path, parts: Iterator[Gaussians], origin: Float64[np.ndarray, " 3"], sources: Sequence[str], overwrite: bool
) -> Tiles:
    """Write tiles as they come, all or none. parts: counted from `origin`, with the columns block and source_row.

    Raises: InputError: as `replacing_folder`; parts of which some are drawn antialiased.
    """
    with replacing_folder(path, overwrite, TILES) as folder:
        writer = _Writer(folder, origin)
        for part in parts:
            writer.add(part)
        with replacing(folder / TILES) as out:
            out.write((json.dumps(sealed(writer.manifest(sources)), indent=1) + "\n").encode())
    return read_tiles(path)
