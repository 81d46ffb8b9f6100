"""glTF 2.0 as a container: the document, its buffers, and numbers out of them; nothing in it is trusted.

A GLB has its document and one buffer in one file; a `.gltf` is the document alone, whose buffers are base64 in it or
files beside it. Source: glTF 2.0 specification, sections 3.6 (buffers, accessors) and 4 (GLB).

Its nodes, from the roots of the scene down, place its meshes.

Names and numbers of a GLB file with Gaussians, which its reader and its writer share.

Source: glTF 2.0; KHR_gaussian_splatting (release candidate of 2026); EXT_mesh_features; EXT_structural_metadata.
"""

import base64
import binascii
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..base.arrays import Array, Float64, Matrix3, Matrix4
from ..base.contents import file_bytes
from ..errors import FormatError
from ..scene.gaussians import rotation_matrices
from ..scene.similarity import quaternion_of
from .axes import HALF_TURN, standing_up
from .json_files import as_list, as_vector, document_in, excerpt
from .photo_files import safe_name

MAGIC, VERSION = b"glTF", 2
HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
CHUNK = struct.Struct("<I4s")  # bytes of the chunk, its kind
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\x00"
MAX_FILE_BYTES = 2**32 - 1  # a header's limit

SPLATTING, SPZ = "KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"
FEATURES, METADATA = "EXT_mesh_features", "EXT_structural_metadata"
KERNEL, COLOR_SPACE, LINEAR_COLOR_SPACE = "ellipse", "srgb_rec709_display", "lin_rec709_display"
POINTS_MODE = 0  # of a primitive
POSITION, COLOR = "POSITION", "COLOR_0"
ROTATION, SCALE, OPACITY = (f"{SPLATTING}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))
HARMONICS = tuple(f"{SPLATTING}:SH_DEGREE_{degree}_COEF_{n}" for degree in range(4) for n in range(2 * degree + 1))
FEATURE_ID, RELEVANCY = "_FEATURE_ID_0", "_RELEVANCY"

BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, UNSIGNED_INT, FLOAT = 5120, 5121, 5122, 5123, 5125, 5126
COMPONENTS = {BYTE: "<i1", UNSIGNED_BYTE: "<u1", SHORT: "<i2", UNSIGNED_SHORT: "<u2", UNSIGNED_INT: "<u4", FLOAT: "<f4"}
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT3": 9, "MAT4": 16}

OURS = "drsplat"  # the name under which `extras` of the root node say what glTF has no place for


def rotation_xyzw(rotation: Matrix3) -> list[float]:
    """Return a rotation as a node has it: a unit quaternion x, y, z, w."""
    w, x, y, z = (float(number) + 0.0 for number in quaternion_of(rotation).round(15))
    return [x, y, z, w]


TURN_ABOUT_Z = np.diag([-1.0, -1.0, 1.0])
SAME_ROTATION_TOLERANCE = 1e-6  # between the entries of a rotation as stored and as computed


DATA_URI = "data:"
MAX_STRIDE_BYTES = 252
Entry = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Gltf:
    """A document and where its buffers come from.

    document: as JSON had it; anything may be in it. binary: of a GLB, None where there is none. folder: that files of
    buffers lie in, None where nothing beside the document may be read.
    """

    document: Entry
    binary: memoryview | None = None
    folder: Path | None = None
    _buffers: dict[int, memoryview] = field(default_factory=dict)

    def entries(self, name: str) -> list[Any]:
        """Return a list of the document, [] where there is none. Raises: FormatError: it is no list."""
        return listed(self.document, name, "glTF")

    def entry(self, name: str, number: object) -> Entry:
        """Return one object of such a list. Raises: FormatError: there is no object of that number."""
        entries = self.entries(name)
        place = whole_number(number, f"a number of {name}", len(entries))
        entry = entries[place]
        if not isinstance(entry, dict):
            raise FormatError(f"{name}[{place}]: expected an object, got {excerpt(entry)}")
        return entry

    @property
    def num_bytes(self) -> int:
        """Bytes of all buffers. Raises: FormatError: one is not there, or shorter than it says."""
        return sum(len(self._buffer(place)) for place in range(len(self.entries("buffers"))))

    def view(self, number: object) -> memoryview:
        """Return the bytes of a buffer view. Raises: FormatError: they are not all there."""
        entry = self.entry("bufferViews", number)
        buffer = self._buffer(entry.get("buffer"))
        begin = whole_number(entry.get("byteOffset", 0), "byteOffset")
        end = begin + whole_number(entry.get("byteLength"), "byteLength")
        if end > len(buffer):
            raise FormatError(f"bufferViews[{number}] ends at byte {end} of a buffer of {len(buffer)}: truncated")
        return buffer[begin:end]

    def accessor(self, number: object, kind: str, what: str, components: tuple[int, ...] = tuple(COMPONENTS)) -> Array:
        """Return the numbers of an accessor as they are stored, (count, width), without a copy.

        kind: "SCALAR", "VEC3", ... components: kinds of numbers that `what` may have.

        Raises: FormatError: another kind, more than there is in the file, sparse values.
        """
        entry = self.entry("accessors", number)
        component = entry.get("componentType")
        if entry.get("type") != kind or component not in components:
            raise FormatError(
                f"{what}: expected {kind} of the types {', '.join(map(str, components))}, got "
                f"{excerpt(entry.get('type'))} of {excerpt(component)}"
            )
        if "sparse" in entry or "bufferView" not in entry:
            raise FormatError(f"{what}: sparse accessors and those without data cannot be read: write it whole")
        dtype, width = np.dtype(COMPONENTS[component]), NUMBERS_OF_TYPE[kind]
        count, offset = (
            whole_number(entry.get("count"), f"{what}: count"),
            whole_number(entry.get("byteOffset", 0), "byteOffset"),
        )
        view, row_bytes = self.view(entry["bufferView"]), width * dtype.itemsize
        stride = self.entry("bufferViews", entry["bufferView"]).get("byteStride", row_bytes)
        stride = whole_number(stride, f"{what}: byteStride", MAX_STRIDE_BYTES + 1)
        if stride < row_bytes:
            raise FormatError(f"{what}: rows of {row_bytes} bytes in steps of {stride}")
        if count and offset + (count - 1) * stride + row_bytes > len(view):
            raise FormatError(f"{what}: {count} rows do not fit into {len(view)} bytes: truncated or damaged")
        shape, strides = (count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, view, offset if count else 0, strides)

    def values(self, number: object, kind: str, what: str, components: tuple[int, ...] = tuple(COMPONENTS)) -> Array:
        """Return the numbers of an accessor as float32, a copy: integers that are normalised as shares of 1.

        Raises: FormatError: as `accessor`.
        """
        stored = self.accessor(number, kind, what, components)
        result = stored.astype(np.float32)
        if self.entry("accessors", number).get("normalized") is True and stored.dtype.kind != "f":
            np.maximum(result / np.float32(np.iinfo(stored.dtype).max), np.float32(-1), out=result)
        return result

    def _buffer(self, number: object) -> memoryview:
        place = whole_number(number, "buffer", len(self.entries("buffers")))
        if place not in self._buffers:
            entry = self.entry("buffers", place)
            content = self._content(entry.get("uri"), place)
            length = whole_number(entry.get("byteLength"), f"buffers[{place}]: byteLength")
            if length > len(content):
                raise FormatError(f"buffers[{place}]: expected {length} bytes, got {len(content)}: truncated")
            self._buffers[place] = content[:length]
        return self._buffers[place]

    def _content(self, uri: object, place: int) -> memoryview:
        if uri is None and place == 0 and self.binary is not None:
            return self.binary
        if not isinstance(uri, str):
            raise FormatError(f"buffers[{place}]: expected the binary chunk of a GLB or a uri, got {excerpt(uri)}")
        if uri.startswith(DATA_URI):
            head, _, body = uri.partition(",")
            if not head.endswith(";base64"):
                raise FormatError(f"buffers[{place}]: expected a data uri in base64, got {excerpt(head)}")
            try:
                return memoryview(base64.b64decode(body, validate=True))
            except (binascii.Error, ValueError) as error:
                raise FormatError(f"buffers[{place}]: base64 is damaged: {error}") from None
        name = unquote(uri)
        if self.folder is None or ":" in name or "/" in name or "\\" in name:
            raise FormatError(
                f"buffers[{place}]: {excerpt(uri)}: only files right beside the document are read: put it there, or "
                "pack both into one .glb"
            )
        path = self.folder / safe_name(name, f"buffers[{place}]")
        return file_bytes(path).data


def gltf_in(buffer: memoryview, folder: Path | None = None) -> Gltf:
    """Return the document of a GLB or a `.gltf`, and its buffers.

    folder: that files beside it may be read from, None for none.

    Raises: FormatError: neither, truncated, damaged, or of another version.
    """
    if bytes(buffer[:4]) == MAGIC:
        text, binary = _chunks(buffer)
    else:
        text, binary = buffer, None
    document = document_in(bytes(text), "glTF")
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise FormatError("glTF: expected an object with 'asset'")
    version = document["asset"].get("version")
    if not isinstance(version, str) or not version.startswith("2."):
        raise FormatError(f"glTF of version {excerpt(version)}; version 2.0 can be read: export it again")
    return Gltf(document, binary, folder)


def _chunks(buffer: memoryview) -> tuple[memoryview, memoryview | None]:
    if len(buffer) < HEADER.size + CHUNK.size:
        raise FormatError("GLB is truncated in its header")
    _, version, size = HEADER.unpack_from(buffer)
    if version != VERSION or size != len(buffer):
        raise FormatError(f"GLB says version {version} and {size} bytes; expected 2 and {len(buffer)}: truncated?")
    found: dict[bytes, memoryview] = {}
    offset = HEADER.size
    while offset + CHUNK.size <= size:
        length, kind = CHUNK.unpack_from(buffer, offset)
        offset += CHUNK.size
        if offset + length > size:
            raise FormatError(f"GLB: a chunk of {length} bytes ends beyond the file: truncated or damaged")
        found.setdefault(kind, buffer[offset : offset + length])
        offset += length
    if JSON_CHUNK not in found:
        raise FormatError("GLB has no chunk of JSON: it is damaged")
    return found[JSON_CHUNK], found.get(BINARY_CHUNK)


def listed(entry: object, name: str, where: str) -> list[Any]:
    """Return a list of an object, [] where there is none. Raises: FormatError: it is no list."""
    return as_list(inner(entry).get(name, []), f"{where}: {name}")


def inner(entry: object, *names: str) -> Entry:
    """Return what lies below some names of an object, {} where there is nothing, or something else."""
    for name in names:
        entry = entry.get(name) if isinstance(entry, dict) else None
    return entry if isinstance(entry, dict) else {}


def whole_number(value: object, where: str, below: int = 1 << 62) -> int:
    """Return a whole number of 0 or more. Raises: FormatError: it is none, or not below `below`."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < below:
        raise FormatError(f"glTF: {where}: expected a whole number from 0 to {below - 1}, got {excerpt(value)}")
    return value


def placed_meshes(gltf: Gltf) -> Iterator[tuple[int, Matrix4]]:
    """Yield each mesh that a node of the scene shows, and the matrix from its own axes to those of a PLY's world.

    Raises: FormatError: a node that is in two places or within itself, or whose numbers are none.
    """
    to_ply = np.eye(4)
    generator = inner(gltf.document, "asset").get("generator")
    to_ply[:3, :3] = (
        TURN_ABOUT_Z if isinstance(generator, str) and generator.startswith("splat-transform") else HALF_TURN
    )
    waiting = [(number, to_ply) for number in reversed(_roots(gltf))]
    seen: set[int] = set()
    while waiting:
        number, above = waiting.pop()
        node = gltf.entry("nodes", number)
        if number in seen:
            raise FormatError(f"glTF: node {number} is in two places, or within itself: damaged")
        seen.add(number)
        here = np.eye(4) if above is to_ply and is_world(node) else above @ local_matrix(node, number)
        if not np.isfinite(here).all():
            raise FormatError(f"glTF: node {number} stands beyond all numbers: damaged")
        if "mesh" in node:
            yield whole_number(node["mesh"], "mesh", len(gltf.entries("meshes"))), here
        waiting += [(child, here) for child in reversed(_numbers(gltf, node, "children"))]


def is_world(node: Entry) -> bool:
    """Return whether drsplat wrote this node to stand a scene's world up, and nobody has turned it since."""
    said = inner(node, "extras", OURS)
    up, rotation = said.get("up"), node.get("rotation")
    if said.get("frame") != "world" or {"matrix", "translation", "scale"} & node.keys():
        return False
    try:
        direction = as_vector(up, 3, "up")
        given = _rotation(as_vector(rotation, 4, "rotation"))
    except FormatError:
        return False
    length = float(np.linalg.norm(direction))
    return 1e-6 < length < 1e6 and bool(np.abs(given - standing_up(direction)).max() < SAME_ROTATION_TOLERANCE)


def local_matrix(node: Entry, number: int) -> Matrix4:
    """Return the matrix of a node, from its axes to those above it. Raises: FormatError: no numbers."""
    where = f"glTF: node {number}"
    if "matrix" in node:
        return np.asarray(as_vector(node["matrix"], 16, f"{where}: matrix").reshape(4, 4).T)
    matrix = np.eye(4)
    rotation = _rotation(as_vector(node.get("rotation", [0, 0, 0, 1]), 4, f"{where}: rotation"))
    matrix[:3, :3] = rotation * as_vector(node.get("scale", [1, 1, 1]), 3, f"{where}: scale")
    matrix[:3, 3] = as_vector(node.get("translation", [0, 0, 0]), 3, f"{where}: translation")
    return matrix


def _rotation(xyzw: Float64[Array, " 4"]) -> Matrix3:
    return rotation_matrices(xyzw[None, [3, 0, 1, 2]] / np.linalg.norm(xyzw))[0]


def _roots(gltf: Gltf) -> list[int]:
    scenes = gltf.entries("scenes")
    if scenes:
        return _numbers(gltf, gltf.entry("scenes", gltf.document.get("scene", 0)), "nodes")
    nodes = gltf.entries("nodes")
    below = {child for node in nodes for child in _numbers(gltf, node, "children")}
    return [number for number in range(len(nodes)) if number not in below]


def _numbers(gltf: Gltf, entry: object, name: str) -> list[int]:
    count = len(gltf.entries("nodes"))
    return [whole_number(number, name, count) for number in listed(entry, name, "glTF")]
