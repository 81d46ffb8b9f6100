"""The content of a 3D Tile: a GLB whose Gaussians are one SPZ stream, with the objects that are in it.

CesiumJS draws splats of a tileset only where KHR_gaussian_splatting and its child for SPZ are both required; the
attributes are then declared by accessors without data. Numbers of objects are an attribute of its own, with data.

Source: KHR_gaussian_splatting, KHR_gaussian_splatting_compression_spz_2 (draft), EXT_mesh_features,
EXT_structural_metadata.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..arrays import Float64, Int32
from ..scene.gaussians import Gaussians
from ..scene.labelled import Thing
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
from .glb_writing import ALIGNMENT, ARRAY_BUFFER, NO_OBJECT_FLOAT, head_of
from .spz_writing import TO_RUB, spz_bytes

KEPT = {"kernel": KERNEL, "colorSpace": COLOR_SPACE, "sortingMethod": "cameraDistance"}


@dataclass
class _Binary:
    """The binary chunk while it is laid out, each part at a multiple of 8 bytes."""

    parts: list[bytes] = field(default_factory=list)
    views: list[dict[str, Any]] = field(default_factory=list)
    size: int = 0

    def view(self, content: bytes, **more: Any) -> int:
        content = content or b"\0"
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(content), **more})
        self.parts.append(content + bytes(-len(content) % ALIGNMENT))
        self.size += len(self.parts[-1])
        return len(self.views) - 1


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

    binary = _Binary()
    extensions: dict[str, Any] = {
        SPLATTING: {**KEPT, "projection": "perspective", "extensions": {SPZ: {"bufferView": _spz(binary, gaussians)}}}
    }
    accessors, attributes = _declared(gaussians)
    document: dict[str, Any] = {}
    if objects is not None and (objects >= 0).any():
        used, rows = np.unique(objects, return_inverse=True)
        places = np.where(used < 0, NO_OBJECT_FLOAT, np.cumsum(used >= 0) - 1)[rows.reshape(-1)].astype("<f4")
        attributes[FEATURE_ID] = len(accessors)
        view = binary.view(places.tobytes(), target=ARRAY_BUFFER)
        accessors.append({"bufferView": view, "componentType": FLOAT, "count": len(places), "type": "SCALAR"})
        table = [(_number(int(place), things[place]), things[place]) for place in used if place >= 0]
        feature = {"featureCount": len(table), "nullFeatureId": NO_OBJECT_FLOAT, "attribute": 0, "propertyTable": 0}
        extensions[FEATURES] = {"featureIds": [{**feature, "label": "objects"}]}
        document["extensions"] = {METADATA: _table(binary, table)}
    names = [SPLATTING, SPZ, *([FEATURES] if FEATURES in extensions else []), *document.get("extensions", {})]
    document |= {
        "asset": {"version": "2.0", "generator": f"drsplat {__version__}"},
        "extensionsUsed": names,
        "extensionsRequired": [SPLATTING, SPZ],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *(offset * TO_RUB + 0.0).tolist(), 1]}],
        "meshes": [{"primitives": [{"attributes": attributes, "mode": 0, "extensions": extensions}]}],
        "accessors": accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": binary.size}],
    }
    return head_of(document, binary.size) + b"".join(binary.parts)


def _spz(binary: _Binary, gaussians: Gaussians) -> int:
    return binary.view(spz_bytes(gaussians))


def _declared(gaussians: Gaussians) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """Return the accessors of what the SPZ stream holds, in which nothing is stored, and the attributes they are of."""
    turned = gaussians.means * TO_RUB
    kinds = {
        POSITION: ("VEC3", FLOAT, {"min": turned.min(0).tolist(), "max": turned.max(0).tolist()}),
        COLOR: ("VEC4", UNSIGNED_BYTE, {"normalized": True}),
        ROTATION: ("VEC4", FLOAT, {}),
        SCALE: ("VEC3", FLOAT, {}),
        OPACITY: ("SCALAR", FLOAT, {}),
    }
    kinds |= {name: ("VEC3", FLOAT, {}) for name in HARMONICS[1 : gaussians.sh.shape[1]]}
    accessors = [
        {"componentType": component, "count": len(gaussians), "type": kind, **more}
        for kind, component, more in kinds.values()
    ]
    return accessors, {name: number for number, name in enumerate(kinds)}


def _number(place: int, thing: Thing) -> int:
    """Return the number of an object as `drsplat objects` counts, its place where it has none."""
    return place if thing.number < 0 else thing.number


def _table(binary: _Binary, things: list[tuple[int, Thing]]) -> dict[str, Any]:
    """Lay out the table of a tile's objects: numbers, names, scores and boxes."""
    texts = [thing.name.encode(errors="replace") for _, thing in things]
    offsets = np.cumsum([0, *map(len, texts)]).astype("<u4")
    columns: dict[str, tuple[dict[str, Any], np.ndarray]] = {
        "number": ({"type": "SCALAR", "componentType": "INT32"}, np.array([number for number, _ in things], "<i4")),
        "score": (_float("SCALAR"), np.array([thing.score for _, thing in things], "<f4")),
        "center": (_float("VEC3"), np.array([thing.center for _, thing in things], "<f4")),
        "extent": (_float("VEC3"), np.array([thing.extent for _, thing in things], "<f4")),
        "axes": (_float("MAT3"), np.array([thing.axes for _, thing in things], "<f4")),
    }
    schema = {name: {**kind, "required": True} for name, (kind, _) in columns.items()}
    schema["name"] = {"type": "STRING", "required": True}
    properties: dict[str, Any] = {
        name: {"values": binary.view(values.tobytes())} for name, (_, values) in columns.items()
    }
    properties["name"] = {
        "values": binary.view(b"".join(texts)), "stringOffsets": binary.view(offsets.tobytes()),
        "stringOffsetType": "UINT32",
    }  # fmt: skip
    return {
        "schema": {"id": "drsplat", "classes": {"object": {"properties": schema}}},
        "propertyTables": [{"name": "objects", "class": "object", "count": len(things), "properties": properties}],
    }


def _float(kind: str) -> dict[str, Any]:
    return {"type": kind, "componentType": "FLOAT32"}
