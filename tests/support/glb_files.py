"""GLB files as bytes, and out of bytes, by the specifications alone: nothing of the package writes or reads here.

Source: glTF 2.0; KHR_gaussian_splatting; EXT_mesh_features; EXT_structural_metadata.
"""

import json
import struct
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from drsplat.scene.gaussians import Gaussians

SPLATTING = "KHR_gaussian_splatting"
KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4"}
NUMPY = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT3": 9}
COMPONENTS = {"FLOAT32": "<f4", "INT32": "<i4", "UINT32": "<u4"}


@dataclass
class Building:
    """A file while it is put together."""

    document: dict[str, Any] = field(
        default_factory=lambda: {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
    )
    content: bytearray = field(default_factory=bytearray)

    def view(self, raw: bytes, **more: Any) -> int:
        self.content += bytes(-len(self.content) % 8)
        views = self.document["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(self.content), "byteLength": len(raw), **more})
        self.content += raw
        return len(views) - 1

    def attribute(self, values: np.ndarray, **more: Any) -> int:
        """Append values with rows of whole words."""
        rows = np.ascontiguousarray(values.reshape(len(values), -1))
        stride = -(-rows.dtype.itemsize * rows.shape[1] // 4) * 4
        padded = np.zeros((len(rows), stride), np.uint8)
        padded[:, : rows.dtype.itemsize * rows.shape[1]] = rows.view(np.uint8).reshape(len(rows), -1)
        entry = {"componentType": KINDS[values.dtype.str[1:]], "count": len(values), "type": TYPES[values.shape[1:]]}
        view = self.view(padded.tobytes(), byteStride=stride)
        self.document["accessors"].append({"bufferView": view, **entry, **more})
        return len(self.document["accessors"]) - 1

    def glb(self) -> bytes:
        self.document["buffers"] = [{"byteLength": len(self.content)}]
        return glb_of(self.document, bytes(self.content))


def glb_of(document: dict[str, Any], content: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    content += bytes(-len(content) % 4)
    size = 12 + 8 + len(text) + 8 + len(content)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    return struct.pack("<4sII", b"glTF", 2, size) + chunks


def splat_attributes(building: Building, g: Gaussians) -> dict[str, int]:
    """Lay out Gaussians as floats, rotations x, y, z, w."""
    attributes = {
        "POSITION": building.attribute(g.means, min=g.means.min(0).tolist(), max=g.means.max(0).tolist()),
        f"{SPLATTING}:ROTATION": building.attribute(np.roll(g.quats, -1, axis=1)),
        f"{SPLATTING}:SCALE": building.attribute(g.scales),
        f"{SPLATTING}:OPACITY": building.attribute(g.opacities),
    }
    names = [f"{SPLATTING}:SH_DEGREE_{degree}_COEF_{n}" for degree in range(4) for n in range(2 * degree + 1)]
    return attributes | {name: building.attribute(g.sh[:, k]) for k, name in enumerate(names[: g.sh.shape[1]])}


def finish(building: Building, *primitives: dict[str, Any], node: dict[str, Any] | None = None) -> bytes:
    """Put primitives with their attributes into a mesh of one node."""
    splatting = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    described = [
        {"attributes": attributes, "mode": 0, "extensions": {SPLATTING: splatting}} for attributes in primitives
    ]
    building.document |= {"extensionsUsed": [SPLATTING], "scene": 0, "scenes": [{"nodes": [0]}]}
    building.document |= {"nodes": [{"mesh": 0, **(node or {})}], "meshes": [{"primitives": described}]}
    return building.glb()


def glb_bytes(g: Gaussians, node: dict[str, Any] | None = None) -> bytes:
    building = Building()
    return finish(building, splat_attributes(building, g), node=node)


def small_glb_bytes(g: Gaussians) -> bytes:
    """With integers where the extension allows them: rotations, scales up to 1, opacities."""
    building = Building()
    attributes = splat_attributes(building, g)
    xyzw = np.roll(g.quats, -1, axis=1)
    attributes[f"{SPLATTING}:ROTATION"] = building.attribute(np.rint(xyzw * 32767).astype(np.int16), normalized=True)
    scales = np.rint(np.minimum(g.scales, 1) * 65535).astype(np.uint16)
    attributes[f"{SPLATTING}:SCALE"] = building.attribute(scales, normalized=True)
    opacities = np.rint(g.opacities * 255).astype(np.uint8)
    attributes[f"{SPLATTING}:OPACITY"] = building.attribute(opacities, normalized=True)
    return finish(building, attributes)


def spz_glb_bytes(g: Gaussians, spz: bytes) -> bytes:
    """With the child extension: attributes are declared, and their numbers are in an SPZ."""
    building = Building()
    view = building.view(spz)
    accessor = {"componentType": 5126, "count": len(g), "type": "VEC3"}
    building.document["accessors"] = [accessor]
    content = finish(building, {"POSITION": 0})
    name = f"{SPLATTING}_compression_spz_2"
    document, binary = parts_of(content)
    document["meshes"][0]["primitives"][0]["extensions"][SPLATTING]["extensions"] = {name: {"bufferView": view}}
    document["extensionsRequired"] = [SPLATTING, name]
    return glb_of(document, binary)


# --- reading ---


def parts_of(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the document and the binary chunk."""
    magic, version, size = struct.unpack_from("<4sII", content)
    assert (magic, version, size) == (b"glTF", 2, len(content))
    length, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    assert length % 4 == 0
    length_of_binary, kind = struct.unpack_from("<I4s", content, 20 + length)
    assert kind == b"BIN\0"
    assert 28 + length + length_of_binary == size
    return json.loads(content[20 : 20 + length]), content[28 + length :]


@dataclass
class Read:
    """A file that was written, by what the specifications say where things are."""

    document: dict[str, Any]
    binary: bytes

    @classmethod
    def of(cls, content: bytes) -> "Read":
        return cls(*parts_of(content))

    @property
    def primitive(self) -> dict[str, Any]:
        return self.document["meshes"][0]["primitives"][0]

    def view(self, number: int) -> bytes:
        view = self.document["bufferViews"][number]
        begin = view.get("byteOffset", 0)
        return self.binary[begin : begin + view["byteLength"]]

    def attribute(self, name: str) -> np.ndarray:
        accessor = self.document["accessors"][self.primitive["attributes"][name]]
        view = self.document["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(NUMPY[accessor["componentType"]]), WIDTHS[accessor["type"]]
        stride = view.get("byteStride", dtype.itemsize * width)
        assert stride % 4 == 0
        assert (view["byteOffset"] + accessor.get("byteOffset", 0)) % 4 == 0
        raw = np.frombuffer(self.view(accessor["bufferView"]), np.uint8).reshape(-1, stride)
        rows = np.ascontiguousarray(raw[: accessor["count"], : dtype.itemsize * width]).view(dtype)
        return rows[:, 0] if width == 1 else rows

    def table(self, number: int) -> dict[str, list[Any]]:
        """Return the columns of a property table by name."""
        metadata = self.document["extensions"]["EXT_structural_metadata"]
        table = metadata["propertyTables"][number]
        described = metadata["schema"]["classes"][table["class"]]["properties"]
        return {
            name: self._column(described[name], entry, table["count"]) for name, entry in table["properties"].items()
        }

    def _column(self, described: dict[str, Any], entry: dict[str, Any], count: int) -> list[Any]:
        raw = self.view(entry["values"])
        if described["type"] == "STRING":
            offsets = np.frombuffer(self.view(entry["stringOffsets"]), "<u4")
            assert len(offsets) == count + 1
            return [raw[begin:end].decode() for begin, end in pairwise(offsets)]
        width = WIDTHS[described["type"]] * (described["count"] if described.get("array") else 1)
        values = np.frombuffer(raw, COMPONENTS[described["componentType"]])
        return list(values) if width == 1 else list(values.reshape(count, width))

    def object_names(self) -> list[str | None]:
        """Return the name of each Gaussian's object, by its feature and the table that this names."""
        (features,) = self.primitive["extensions"]["EXT_mesh_features"]["featureIds"]
        ids = self.attribute(f"_FEATURE_ID_{features['attribute']}")
        names = self.table(features["propertyTable"])["name"]
        return [None if row == features["nullFeatureId"] else names[int(row)] for row in ids]
