"""Writing GLB (binary glTF 2.0): Gaussians with their objects, names, boxes and the answer to a query.

Splats are points with the extension KHR_gaussian_splatting, all numbers as floats; objects are features of
EXT_mesh_features with rows of a property table of EXT_structural_metadata; relevancy is a property attribute. Rows are
converted block by block on their way to the disk. Written by hand: a library for glTF (pygltflib) would hold the whole
binary chunk in memory, and knows none of these extensions.

Source: as of `glb_layout`; README of each extension for the layout of tables and features.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Array, Harmonics, Ids, Matrix3, UInt8, Vector3
from ..base.contents import Document
from ..errors import InputError
from ..scene.gaussians import SH_C0, Gaussians
from ..scene.labelled import Annotation, LabelledScene, Thing
from .axes import standing_up
from .glb_tables import Columns, tables_of
from .gltf import (
    BINARY_CHUNK,
    CHUNK,
    COLOR,
    COLOR_SPACE,
    COMPONENTS,
    FEATURE_ID,
    FEATURES,
    FLOAT,
    HARMONICS,
    HEADER,
    JSON_CHUNK,
    KERNEL,
    MAGIC,
    MAX_FILE_BYTES,
    METADATA,
    NUMBERS_OF_TYPE,
    OPACITY,
    OURS,
    POINTS_MODE,
    POSITION,
    RELEVANCY,
    ROTATION,
    SCALE,
    SPLATTING,
    UNSIGNED_BYTE,
    UNSIGNED_SHORT,
    VERSION,
    rotation_xyzw,
)
from .replacing import replacing

BLOCK_ROWS = 1 << 14  # that are converted at once
ARRAY_BUFFER = 34962
NO_OBJECT_SHORT, NO_OBJECT_FLOAT = 2**16 - 1, 2**24 - 1  # the last numbers that both can hold
ALIGNMENT_BYTES = 8  # of parts of the file, so that tables of 64-bit numbers may follow
SPLAT_KINDS = {  # of attributes; those of harmonics follow
    POSITION: ("VEC3", FLOAT), COLOR: ("VEC4", UNSIGNED_BYTE), ROTATION: ("VEC4", FLOAT), SCALE: ("VEC3", FLOAT),
    OPACITY: ("SCALAR", FLOAT),
}  # fmt: skip
Rows = Callable[[slice], np.ndarray]


@dataclass
class Binary:
    """The binary chunk while it is laid out: its parts, and the views and accessors of the document into them."""

    parts: list[tuple[int, int, Rows]] = field(default_factory=list)
    views: list[Document] = field(default_factory=list)
    accessors: list[Document] = field(default_factory=list)
    size: int = 0

    def view(self, num_rows: int, row_bytes: int, rows: Rows, **more: Any) -> int:
        """Append rows of bytes that are made when they are written; returns the number of their view."""
        size = num_rows * row_bytes
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": size, **more})
        self.parts.append((num_rows, row_bytes, rows))
        self.size += -(-size // ALIGNMENT_BYTES) * ALIGNMENT_BYTES
        return len(self.views) - 1

    def attribute(self, count: int, kind: str, component: int, rows: Rows, **more: Any) -> int:
        """Append a value per Gaussian, padded to whole words; returns the number of its accessor."""
        dtype, width = np.dtype(COMPONENTS[component]), NUMBERS_OF_TYPE[kind]
        words = -(-width * dtype.itemsize // 4) * (4 // dtype.itemsize)

        def padded(block: slice) -> Array:
            values = rows(block).reshape(-1, width)
            whole = values if words == width else np.pad(values, ((0, 0), (0, words - width)))
            return whole.astype(dtype, copy=False)

        row_bytes = words * dtype.itemsize
        view = self.view(count, row_bytes, padded, byteStride=row_bytes, target=ARRAY_BUFFER)
        accessor = {"bufferView": view, "componentType": component, "count": count, "type": kind, **more}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def column(self, values: Array) -> int:
        """Append a column of a table; returns the number of its view."""
        raw = np.frombuffer(values.tobytes() or b"\0", np.uint8)  # a view has a byte at least
        return self.view(len(raw), 1, lambda rows: raw[rows])

    def blocks(self) -> Iterator[bytes]:
        """Yield the chunk, a block of rows at a time."""
        for num_rows, row_bytes, rows in self.parts:
            for begin in range(0, num_rows, BLOCK_ROWS):
                yield np.ascontiguousarray(rows(slice(begin, begin + BLOCK_ROWS))).tobytes()
            yield bytes(-num_rows * row_bytes % ALIGNMENT_BYTES)


def write_glb(path: Path, scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene with its objects as GLB; it appears whole or not at all.

    Raises: InputError: more than a GLB can hold, or `path` exists and not `overwrite`.
    """
    binary = Binary()
    document = _document(scene, binary)
    head = head_of(document, binary.size)
    size = len(head) + binary.size
    if size > MAX_FILE_BYTES:
        raise InputError(
            f"{path.name} would have {size / 1e9:.1f} GB, and a GLB holds up to {MAX_FILE_BYTES / 1e9:.2f}: write it "
            "as PLY, SPZ or SOG, cut it into 3D Tiles, or export a part of it"
        )
    with replacing(path, overwrite) as file:
        file.write(head)
        for block in binary.blocks():
            file.write(block)


def head_of(document: Document, binary_size: int) -> bytes:
    """Return a GLB up to its binary chunk, which begins at a multiple of `ALIGNMENT_BYTES`."""
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode(errors="replace")
    text += b" " * (-(HEADER.size + 2 * CHUNK.size + len(text)) % ALIGNMENT_BYTES)
    size = HEADER.size + 2 * CHUNK.size + len(text) + binary_size
    length = min(size, MAX_FILE_BYTES)  # a longer one is refused before it is written
    chunks = CHUNK.pack(len(text), JSON_CHUNK) + text + CHUNK.pack(min(binary_size, MAX_FILE_BYTES), BINARY_CHUNK)
    return HEADER.pack(MAGIC, VERSION, length) + chunks


def _document(scene: LabelledScene, binary: Binary) -> Document:
    from .. import __version__

    primitive = _primitive(scene, binary)
    # the extension's object of the document, {} where there is nothing to say
    metadata = tables_document(tables_of(scene), binary)
    if scene.relevancy is not None:
        query = f" to “{scene.query}”" if scene.query else ""
        relevancy = {"type": "SCALAR", "componentType": "FLOAT32", "required": True}
        schema = metadata.setdefault("schema", {"id": "drsplat", "classes": {}})
        schema["classes"]["splat"] = {"properties": {"relevancy": relevancy | {"description": f"relevancy{query}"}}}
        metadata["propertyAttributes"] = [{"class": "splat", "properties": {"relevancy": {"attribute": RELEVANCY}}}]
    extensions = [SPLATTING, *([FEATURES] if scene.things else []), *([METADATA] if metadata else [])]
    return {
        "asset": {"version": "2.0", "generator": f"drsplat {__version__}"},
        "extensionsUsed": extensions,
        **({"extensions": {METADATA: metadata}} if metadata else {}),
        "scene": 0,
        "scenes": [{"name": scene.title, "nodes": [0]}],
        "nodes": _nodes(scene),
        "meshes": [{"name": scene.title, "primitives": [primitive]}],
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": binary.size}],
    }


def _primitive(scene: LabelledScene, binary: Binary) -> Document:
    extensions: Document = {
        SPLATTING: {
            "kernel": KERNEL,
            "colorSpace": COLOR_SPACE,
            "sortingMethod": "cameraDistance",
            "projection": "perspective",
        }
    }
    attributes = _splat_attributes(scene.gaussians, binary)
    if scene.things and scene.object_of is not None:
        attributes[FEATURE_ID], extensions[FEATURES] = features_of(scene.object_of, len(scene.things), binary)
    if scene.relevancy is not None:
        relevancy, count = scene.relevancy, len(scene.gaussians)
        attributes[RELEVANCY] = binary.attribute(count, "SCALAR", FLOAT, lambda rows: relevancy[rows])
        extensions[METADATA] = {"propertyAttributes": [0]}
    return {"attributes": attributes, "mode": POINTS_MODE, "extensions": extensions}


def _splat_attributes(gaussians: Gaussians, binary: Binary) -> dict[str, int]:
    """Lay out what KHR_gaussian_splatting asks for, and the colours of points for programs that do not know it."""
    g = gaussians
    further = {POSITION: {"min": g.means.min(0).tolist(), "max": g.means.max(0).tolist()}, COLOR: {"normalized": True}}
    rows_of: dict[str, Rows] = {
        POSITION: lambda rows: g.means[rows],
        COLOR: lambda rows: _point_colors(g, rows),
        ROTATION: lambda rows: g.quats[rows][:, [1, 2, 3, 0]],
        SCALE: lambda rows: g.scales[rows],
        OPACITY: lambda rows: g.opacities[rows],
    }
    attributes = {
        name: binary.attribute(len(g), *kind, rows_of[name], **further.get(name, {}))
        for name, kind in SPLAT_KINDS.items()
    }
    for number, name in enumerate(HARMONICS[: g.sh.shape[1]]):
        attributes[name] = binary.attribute(len(g), "VEC3", FLOAT, _coefficient(g.sh, number))
    return attributes


def _coefficient(sh: Harmonics, number: int) -> Rows:
    return lambda rows: sh[rows, number]


def _point_colors(gaussians: Gaussians, rows: slice) -> UInt8[Array, "b 4"]:
    """Return the constant colours in linear light, as glTF has colours of vertices, and the opacities."""
    shown = np.clip(0.5 + SH_C0 * gaussians.sh[rows, 0].astype(np.float64), 0, 1)
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * np.column_stack([linear, gaussians.opacities[rows]])), np.uint8)


def features_of(objects: Ids, count: int, binary: Binary) -> tuple[int, Document]:
    """Lay out the number of each Gaussian's object; returns its accessor, and what EXT_mesh_features says of it.

    objects: rows of the table of objects, -1 for none. count: rows of that table.
    """
    is_short = count <= NO_OBJECT_SHORT
    none = NO_OBJECT_SHORT if is_short else NO_OBJECT_FLOAT
    if count > none:
        raise InputError(f"a GLB holds up to {none:,} objects, got {count:,}: export a part of the scene")

    def ids(rows: slice) -> Array:
        return np.where(objects[rows] < 0, none, objects[rows])

    accessor = binary.attribute(len(objects), "SCALAR", UNSIGNED_SHORT if is_short else FLOAT, ids)
    described = {"featureCount": count, "nullFeatureId": none, "attribute": 0, "propertyTable": 0, "label": "objects"}
    return accessor, {"featureIds": [described]}


def tables_document(tables: Mapping[str, Columns], binary: Binary) -> Document:
    """Lay out tables; returns the document's object of EXT_structural_metadata, {} without tables."""
    classes: Document = {}
    entries: list[Document] = []
    for name, columns in tables.items():
        properties = {
            key: {"values": binary.column(values)}
            | ({} if offsets is None else {"stringOffsets": binary.column(offsets)})
            for key, (_, values, offsets) in columns.items()
        }
        kind, count = name.removesuffix("s"), len(columns["score"][1])
        classes[kind] = {"properties": {key: described for key, (described, *_) in columns.items()}}
        entries.append({"name": name, "class": kind, "count": count, "properties": properties})
    return {"schema": {"id": "drsplat", "classes": classes}, "propertyTables": entries} if tables else {}


def _nodes(scene: LabelledScene) -> list[Document]:
    """Return the root, which stands up as glTF does and in which all else is in the world, the splats and the boxes."""
    own: Document = {"frame": "world", "up": list(scene.up), "fingerprint": scene.gaussians.fingerprint}
    own |= {"antialiased": True} if scene.gaussians.antialiased else {}
    own |= {"encoder": scene.encoder} if scene.encoder else {}
    splats: Document = {"name": "splats", "mesh": 0}
    if scene.gaussians.origin.any():
        splats["translation"] = scene.gaussians.origin.tolist()
    # a node "matches" and a node "annotations", where there are some, with a child for each
    kinds = {
        "matches": [_match(match, scene.query) for match in scene.matches],
        "annotations": [_annotation(one) for one in scene.annotations],
    }
    nodes, roots = [splats], [1]
    for name, children in kinds.items():
        if children:
            number = 1 + len(nodes)
            roots.append(number)
            nodes += [{"name": name, "children": list(range(number + 1, number + 1 + len(children)))}, *children]
    rotation = rotation_xyzw(standing_up(np.array(scene.up, np.float64)))
    return [{"name": scene.title, "rotation": rotation, "children": roots, "extras": {OURS: own}}, *nodes]


def _match(match: Thing, query: str) -> Document:
    said: Document = {"kind": "match", "score": match.score} | ({"query": query} if query else {})
    return {"name": match.name, **_box(match.center, match.axes, match.extent), "extras": said}


def _annotation(one: Annotation) -> Document:
    if one.outline is None:
        box: Document = {"translation": one.center.tolist()}
    else:
        box = _box(one.center, one.outline.axes, one.outline.extent)
    return {"name": one.text, **box, "extras": {"kind": "annotation"}}


def _box(center: Vector3, axes: Matrix3, extent: Vector3) -> Document:
    """Return what makes the cube of side 1 about zero a box; columns of the rotation are the box's directions."""
    columns = axes.T * [1.0, 1.0, np.sign(np.linalg.det(axes))]  # people may write a left-handed box, which is the same
    return {"translation": center.tolist(), "rotation": rotation_xyzw(columns), "scale": extent.tolist()}
