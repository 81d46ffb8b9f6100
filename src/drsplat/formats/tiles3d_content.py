"""The content of a 3D Tile: a GLB whose Gaussians are one SPZ stream, with the objects that are in it.

CesiumJS draws splats of a tileset only where KHR_gaussian_splatting and its child for SPZ are both required; the
attributes are then declared by accessors without data. Numbers of objects are an attribute of its own, with data.

Source: KHR_gaussian_splatting, KHR_gaussian_splatting_compression_spz_2 (draft), EXT_mesh_features,
EXT_structural_metadata.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.arrays import Float64, Int32
from ..scene.gaussians import Gaussians
from ..scene.labelled import Thing, numbers_of
from .glb_layout import (
    COLOR,
    COLOR_SPACE,
    FEATURE_ID,
    FEATURES,
    FLOAT,
    HARMONICS,
    KERNEL,
    METADATA,
    OPACITY,
    POSITION,
    ROTATION,
    SCALE,
    SPLATTING,
    SPZ,
    UNSIGNED_BYTE,
)
from .glb_tables import Table, object_table
from .glb_writing import Binary, features_of, head_of, tables_document
from .spz_writing import TO_RUB, spz_bytes

KEPT = {"kernel": KERNEL, "colorSpace": COLOR_SPACE, "sortingMethod": "cameraDistance"}


def content_glb(
    gaussians: Gaussians,
    offset: Float64[np.ndarray, " 3"],
    objects: Int32[np.ndarray, " n"] | None = None,
    things: tuple[Thing, ...] = (),
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
    extensions: dict[str, Any] = {
        SPLATTING: {**KEPT, "projection": "perspective", "extensions": {SPZ: {"bufferView": spz}}}
    }
    attributes = _declared(gaussians, binary)
    document: dict[str, Any] = {}
    if objects is not None and (objects >= 0).any():
        used, table = _table_of(objects, things)
        rows = np.where(objects < 0, -1, np.searchsorted(used, objects)).astype(np.int32)
        attributes[FEATURE_ID], extensions[FEATURES] = features_of(rows, len(used), binary)
        document["extensions"] = {METADATA: tables_document([table], binary)}
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
    kinds = {
        POSITION: ("VEC3", FLOAT, {"min": turned.min(0).tolist(), "max": turned.max(0).tolist()}),
        COLOR: ("VEC4", UNSIGNED_BYTE, {"normalized": True}),
        ROTATION: ("VEC4", FLOAT, {}),
        SCALE: ("VEC3", FLOAT, {}),
        OPACITY: ("SCALAR", FLOAT, {}),
    }
    kinds |= {name: ("VEC3", FLOAT, {}) for name in HARMONICS[1 : gaussians.sh.shape[1]]}
    binary.accessors += [
        {"componentType": component, "count": len(gaussians), "type": kind, **more}
        for kind, component, more in kinds.values()
    ]
    return {name: number for number, name in enumerate(kinds)}


def _table_of(objects: Int32[np.ndarray, " n"], things: Sequence[Thing]) -> tuple[Int32[np.ndarray, " u"], Table]:
    """Return the places of the objects that are in the tile, and their table."""
    used = np.unique(objects[objects >= 0])
    numbers = numbers_of(things)
    return used, object_table([things[place] for place in used], [numbers[place] for place in used])
