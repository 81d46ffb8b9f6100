"""Writing 3D Tiles 1.1: a scene as a tree of levels of detail that viewers of globes load as they need them.

Leaves are runs of neighbouring Gaussians; what is above them is merged from four children to as many Gaussians as the
largest of them has. Tiles wait on disk for the one above, so that a few are in memory whatever the size of the scene.
The tileset's axes are those of a PLY turned upright, in metres; the root's transform sets it on the Earth.

The content of a tile is a GLB whose Gaussians are one SPZ stream, with the objects that are in it. CesiumJS draws
splats of a tileset only where KHR_gaussian_splatting and its child for SPZ are both required; the attributes are then
declared by accessors without data. Numbers of objects are an attribute of its own, with data.

Source: OGC 22-025r4, "3D Tiles Specification 1.1"; KHR_gaussian_splatting, KHR_gaussian_splatting_compression_spz_2
(draft), EXT_mesh_features, EXT_structural_metadata.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Ids, Matrix4, Vector3
from ..base.contents import Document
from ..scene.gaussians import Gaussians, concatenated
from ..scene.geodesy import enu_axes, geocentric
from ..scene.labelled import PLY_UP, LabelledScene, Thing, numbers_of
from ..scene.merging import coarser
from .axes import Z_UP_FROM_PLY, standing_as_ply
from .field_folder import replacing_folder
from .georeference import Georeference
from .glb_tables import object_columns
from .glb_writing import SPLAT_KINDS, Binary, features_of, head_of, tables_document
from .gltf import COLOR, COLOR_SPACE, FEATURE_ID, FEATURES, FLOAT, HARMONICS, KERNEL, METADATA, POSITION, SPLATTING, SPZ
from .json_files import write_json
from .replacing import replacing
from .spz_writing import TO_RUB, spz_bytes
from .tensors import read_tensors, write_tensors
from .tiles import Leaf, Tile, Tiles, leaves_of
from .usd_writing import extent_of

KEPT = {"kernel": KERNEL, "colorSpace": COLOR_SPACE, "sortingMethod": "cameraDistance"}


TILESET = "tileset.json"
LEAF_ROWS = 1 << 16
ARRAYS = ("means", "quats", "scales", "opacities", "sh")
CHILDREN = 4  # of a tile
ERROR_QUANTILE = 0.95  # of how far merging moves the Gaussians: a tile's geometric error
OBJECT = "object_of"  # the column with which numbers of objects go through merging


class TiledScene(NamedTuple):
    """A scene in tiles on disk, with its objects. object_of: per Gaussian of all tiles as in `LabelledScene`."""

    tiles: Tiles
    things: tuple[Thing, ...] = ()
    object_of: Ids | None = None
    up: tuple[float, float, float] = PLY_UP


class _Node(NamedTuple):
    """A tile that is written. waiting: file of its Gaussians, for the tile above. error: metres."""

    tile: Document
    waiting: Path
    num_gaussians: int
    error: float
    low: Vector3
    high: Vector3


def write_tiles3d(
    path: Path,
    source: LabelledScene | TiledScene | Tiles,
    *,
    georeference: Georeference | None = None,
    overwrite: bool = False,
    rows: int = LEAF_ROWS,
) -> None:
    """Write a scene as a folder with a tileset.json and a GLB for each tile; all of it or nothing.

    Args:
        path: the folder.
        source: a scene with its objects, or tiles with or without some, of which a few are in memory at a time.
        georeference: where on the Earth it lies; without one the tileset stands upright about its own middle.
        overwrite: replaces a tileset that is there.
        rows: Gaussians of a leaf, of a scene that is not cut into tiles already.

    Raises: InputError: no Gaussians, or some that no file could give back; `path` exists and not `overwrite`.
    FormatError: damaged tiles.
    """
    source = TiledScene(source) if isinstance(source, Tiles) else source
    if isinstance(source, TiledScene):  # each tile is a leaf
        leaves: list[Leaf] = [partial(_tile_of, source, tile) for tile in source.tiles.tiles]
        middle = leaves_of(source.tiles, LEAF_ROWS)[1]
    else:
        extra = {} if source.object_of is None else {OBJECT: source.object_of}
        leaves, middle = leaves_of(replace(source.gaussians, extra=extra), rows)
    scale = 1.0 if georeference is None else georeference.scale
    with replacing_folder(path, overwrite, TILESET) as folder:
        with tempfile.TemporaryDirectory(dir=folder) as waiting:
            root = _Writer(folder, Path(waiting), middle, scale, source.things).tree(leaves)
        document = _tileset(root, _transform(georeference, middle, source.up))
        write_json(folder / TILESET, document, end="", indent=None, separators=(",", ":"))


def _tile_of(source: TiledScene, tile: Tile) -> Gaussians:
    """Return a tile with the objects of its rows."""
    gaussians = source.tiles.tile(tile)
    if source.object_of is None:
        return gaussians
    return replace(gaussians, extra={OBJECT: source.object_of[tile.first : tile.first + tile.num_rows]})


@dataclass
class _Writer:
    """A folder that is being filled. middle: of the scene in the world; scale: metres of a unit.

    waiting: the folder for Gaussians of tiles until the one above is merged of them.
    """

    folder: Path
    waiting: Path
    middle: Vector3
    scale: float
    things: tuple[Thing, ...]
    count: int = 0

    def tree(self, leaves: Sequence[Leaf]) -> _Node:
        """Write a subtree, its children first."""
        if len(leaves) == 1:
            gaussians = self._local(leaves[0]())
            return self._written(gaussians, 0.0, [])
        size = CHILDREN
        while size * CHILDREN < len(leaves):
            size *= CHILDREN
        step = max(1, size if len(leaves) > size else size // CHILDREN)
        children = [self.tree(leaves[begin : begin + step]) for begin in range(0, len(leaves), step)]
        everything = concatenated([_read_aside(child.waiting) for child in children])
        for child in children:
            child.waiting.unlink()
        most = max(child.num_gaussians for child in children)
        level = coarser(everything, most, everything.extra.get(OBJECT))
        moved = everything.positions - level.gaussians.positions[level.group_of]
        error = float(np.quantile(np.linalg.norm(moved, axis=1), ERROR_QUANTILE))
        error = max(child.error for child in children) + max(error, 1e-6)
        return self._written(level.gaussians, error, children)

    def _local(self, gaussians: Gaussians) -> Gaussians:
        """Return Gaussians in metres, counted from the middle of the scene."""
        means = ((gaussians.means + (gaussians.origin - self.middle)) * self.scale).astype(np.float32)
        kept = {name: column for name, column in gaussians.extra.items() if name == OBJECT}
        scales = gaussians.scales * np.float32(self.scale)
        return replace(gaussians, means=means, scales=scales, origin=np.zeros(3), extra=kept)

    def _written(self, gaussians: Gaussians, error: float, children: list[_Node]) -> _Node:
        name, self.count = f"{self.count}.glb", self.count + 1
        positions = gaussians.positions
        offset = np.asarray((positions.min(0) + positions.max(0)) / 2)
        centred = replace(gaussians, means=(positions - offset).astype(np.float32), origin=np.zeros(3))
        content = content_glb(centred, offset, gaussians.extra.get(OBJECT), self.things)
        with replacing(self.folder / name) as file:
            file.write(content)
        low, high = extent_of(centred).astype(np.float64) + offset
        low = np.min([low, *(child.low for child in children)], axis=0)
        high = np.max([high, *(child.high for child in children)], axis=0)
        # the middle of a box and its three half axes, in the axes of a tileset
        half = np.diag((high - low) / 2) @ Z_UP_FROM_PLY.T
        tile: Document = {
            "boundingVolume": {"box": [*(Z_UP_FROM_PLY @ (low + high) / 2).tolist(), *half.ravel().tolist()]},
            "geometricError": error,
            "content": {"uri": name},
        }
        if children:
            tile |= {"refine": "REPLACE", "children": [child.tile for child in children]}
        waiting = self.waiting / name
        _write_aside(waiting, gaussians)
        return _Node(tile, waiting, len(gaussians), error, low, high)


def _write_aside(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians as they are, to be read by `_read_aside`."""
    arrays = {name: getattr(gaussians, name) for name in ARRAYS} | dict(gaussians.extra)
    write_tensors(path, arrays | {"origin": gaussians.origin, "antialiased": np.array(gaussians.antialiased)})


def _read_aside(path: Path) -> Gaussians:
    """Return what `_write_aside` wrote."""
    arrays, _ = read_tensors(path)
    means, quats, scales, opacities, sh = (arrays[name] for name in ARRAYS)
    objects = {OBJECT: arrays[OBJECT]} if OBJECT in arrays else {}
    return Gaussians(means, quats, scales, opacities, sh, objects, arrays["origin"], bool(arrays["antialiased"]))


def _tileset(root: _Node, transform: Matrix4) -> Document:
    from .. import __version__

    names = [SPLATTING, SPZ]
    whole = float(np.linalg.norm(root.high - root.low))
    return {
        "asset": {"version": "1.1", "generator": f"drsplat {__version__}"},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": {"3DTILES_content_gltf": {"extensionsUsed": names, "extensionsRequired": names}},
        "geometricError": max(whole, root.error),
        "root": {"refine": "REPLACE", **root.tile, "transform": transform.T.ravel().tolist()},
    }


def _transform(georeference: Georeference | None, middle: Vector3, up: tuple[float, float, float]) -> Matrix4:
    """Return the matrix from the tileset to the Earth, or to axes whose z is up. Metres on both sides."""
    matrix = np.eye(4)
    if georeference is None:
        matrix[:3, :3] = Z_UP_FROM_PLY @ standing_as_ply(np.array(up, np.float64)) @ Z_UP_FROM_PLY.T
        return matrix
    place = (georeference.longitude, georeference.latitude, georeference.height)
    earth_from_world = enu_axes(place).T @ georeference.enu_from_world
    matrix[:3, :3] = earth_from_world @ Z_UP_FROM_PLY.T
    matrix[:3, 3] = geocentric(np.array([place]))[0] + earth_from_world @ (georeference.scale * middle)
    return matrix


def content_glb(
    gaussians: Gaussians, offset: Vector3, objects: Ids | None = None, things: tuple[Thing, ...] = ()
) -> bytes:
    """Encode the content of a tile.

    Args:
        gaussians: in metres, counted from the middle of the tile, in the axes of a PLY.
        offset: that middle, counted from the middle of the tileset, in the same axes.
        objects: number of each Gaussian's object in `things`, -1 for none.
        things: objects of the scene; those that are in the tile get a row of its table.
    """
    from .. import __version__

    binary = Binary()
    spz = binary.column(np.frombuffer(spz_bytes(gaussians), np.uint8))
    extensions: Document = {SPLATTING: {**KEPT, "projection": "perspective", "extensions": {SPZ: {"bufferView": spz}}}}
    attributes = _declared(gaussians, binary)
    document: Document = {}
    if objects is not None and (objects >= 0).any():
        used, numbers = np.unique(objects[objects >= 0]), numbers_of(things)  # those that are in the tile
        table = object_columns([things[place] for place in used], [numbers[place] for place in used])
        rows = np.where(objects < 0, -1, np.searchsorted(used, objects)).astype(np.int32)
        attributes[FEATURE_ID], extensions[FEATURES] = features_of(rows, len(used), binary)
        document["extensions"] = {METADATA: tables_document({"objects": table}, binary)}
    names = [SPLATTING, SPZ, *([FEATURES] if FEATURES in extensions else []), *document.get("extensions", {})]
    document |= {
        "asset": {"version": "2.0", "generator": f"drsplat {__version__}"},
        "extensionsUsed": names,
        "extensionsRequired": [SPLATTING, SPZ],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *(offset * TO_RUB + 0.0).tolist(), 1]}],
        "meshes": [{"primitives": [{"attributes": attributes, "mode": 0, "extensions": extensions}]}],
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": binary.size}],
    }
    return head_of(document, binary.size) + b"".join(binary.blocks())


def _declared(gaussians: Gaussians, binary: Binary) -> dict[str, int]:
    """Append accessors of what the SPZ stream holds, in which nothing is stored; returns the attributes they are of."""
    turned = gaussians.means * TO_RUB
    further = {
        POSITION: {"min": turned.min(0).tolist(), "max": turned.max(0).tolist()}, COLOR: {"normalized": True},
    }  # fmt: skip
    kinds = SPLAT_KINDS | dict.fromkeys(HARMONICS[1 : gaussians.sh.shape[1]], ("VEC3", FLOAT))
    binary.accessors += [
        {"componentType": component, "count": len(gaussians), "type": kind, **further.get(name, {})}
        for name, (kind, component) in kinds.items()
    ]
    return {name: number for number, name in enumerate(kinds)}
