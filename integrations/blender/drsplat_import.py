"""Blender add-on: import a scene of Gaussians whose objects drsplat has named, each as a collection of its own.

Reads GLB with KHR_gaussian_splatting, EXT_mesh_features and EXT_structural_metadata, and 3DGS PLY with a column
`object_id`. One file: install it in Edit > Preferences > Add-ons, and then File > Import > Gaussians with objects.

Copyright the drsplat authors. SPDX-License-Identifier: Apache-2.0, which the GPL (version 3) of Blender allows to be
combined with.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.io_utils import ImportHelper
from mathutils import Matrix

bl_info = {
    "name": "Gaussians with objects (drsplat)",
    "author": "the drsplat authors",
    "version": (1, 0, 0),
    "blender": (3, 4, 0),
    "location": "File > Import",
    "description": "Import 3D Gaussian splats as points with attributes, with named objects as collections",
    "category": "Import-Export",
}

SH_C0 = 0.28209479177387814  # constant harmonic: a colour is 0.5 + SH_C0 * coefficient
SPLAT = "KHR_gaussian_splatting"
Z_FROM_Y_UP = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
UP = {  # from the file's axes to Blender's, by what is up in the file
    "-Y": np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float),
    "Y": Z_FROM_Y_UP,
    "Z": np.eye(4),
}
MARKS = ("match", "annotation")  # kinds of nodes that are imported as empties
REST = "rest"  # collection of Gaussians that belong to no object


# of the numbers of an accessor: types by glTF's codes, and how many are in a row
KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class FileError(ValueError):
    """A file that cannot be imported, with the reason."""


@dataclass
class Box:
    """A named object's box in the file's axes. extent: full lengths. axes: unit directions in rows."""

    name: str
    center: np.ndarray
    extent: np.ndarray
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))


@dataclass
class Splats:
    """Gaussians after activation. quats: w, x, y, z. colors: display RGB. objects: number of each one's object, or -1.

    boxes: by object number. matrix: from the file's axes to Blender's. marks: names of matches and annotations, with
    the matrix that makes a cube of side 1 about zero their box, in Blender's axes.
    """

    positions: np.ndarray
    scales: np.ndarray
    quats: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    objects: np.ndarray
    boxes: dict[int, Box]
    matrix: np.ndarray
    marks: list[tuple[str, np.ndarray]] = field(default_factory=list)


# ---- GLB


def read_glb(path: str) -> Splats:
    """Read the first primitive of Gaussians in a GLB file."""
    glb = Glb(Path(path).read_bytes())
    shapes = list(glb.placed_nodes())
    matrix, primitive = glb.splats_among(shapes)
    about = primitive["extensions"][SPLAT]
    if about.get("extensions"):
        raise FileError(f"Gaussians are compressed ({', '.join(about['extensions'])}): export without compression")
    values = {name.removeprefix(f"{SPLAT}:"): at for name, at in primitive["attributes"].items()}
    missing = {"POSITION", "ROTATION", "SCALE", "OPACITY", "SH_DEGREE_0_COEF_0"} - values.keys()
    if missing:
        raise FileError(f"the Gaussians have no {', '.join(sorted(missing))}")
    scales = glb.accessor(values["SCALE"])
    if (scales < 0).any():
        raise FileError("negative scales: logarithms, as files had them before the format was ratified; export again")
    numbers, boxes = glb.objects(primitive, len(scales))
    return Splats(
        glb.accessor(values["POSITION"]), scales, glb.accessor(values["ROTATION"])[:, [3, 0, 1, 2]],
        glb.accessor(values["OPACITY"]).ravel(), 0.5 + SH_C0 * glb.accessor(values["SH_DEGREE_0_COEF_0"]),
        numbers, boxes, Z_FROM_Y_UP @ matrix,
        [(node["name"], Z_FROM_Y_UP @ at) for node, at in shapes if "name" in node and kind_of(node) in MARKS],
    )  # fmt: skip


class Glb:
    """The JSON of a GLB file and its binary chunk, with checked ways to the numbers in it."""

    def __init__(self, data: bytes) -> None:
        head = np.frombuffer(data[:20].ljust(20, b"\0"), "<u4")
        if head[0] != 0x46546C67 or head[1] != 2 or head[4] != 0x4E4F534A or 20 + int(head[3]) > len(data):
            raise FileError("no GLB file of version 2")
        end = 20 + int(head[3])
        self.json = json.loads(data[20:end])
        chunk = np.frombuffer(data[end : end + 8].ljust(8, b"\0"), "<u4")
        self.binary = data[end + 8 : end + 8 + int(chunk[0])] if chunk[1] == 0x004E4942 else b""

    def placed_nodes(self) -> "Iterator[tuple[dict, np.ndarray]]":
        """Yield each node of the scene, with the matrix from its axes to those of the file."""
        nodes = self.json.get("nodes", [])
        scenes = self.json.get("scenes") or [{"nodes": range(len(nodes))}]
        waiting = [(index, np.eye(4)) for index in scenes[self.json.get("scene", 0)].get("nodes", [])]
        for _ in nodes:
            if not waiting:
                return
            index, above = waiting.pop(0)
            node = nodes[index]
            matrix = above @ node_matrix(node)
            yield node, matrix
            waiting += [(child, matrix) for child in node.get("children", [])]

    def splats_among(self, shapes: "list[tuple[dict, np.ndarray]]") -> "tuple[np.ndarray, dict]":
        """Return the matrix of the first node that shows Gaussians, and their primitive."""
        for node, matrix in shapes:
            for primitive in self.json["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
                if SPLAT in primitive.get("extensions", {}):
                    return matrix, primitive
        raise FileError(f"no Gaussians: no mesh has the extension {SPLAT}")

    def view(self, index: int) -> bytes:
        """Return the bytes of a bufferView."""
        view = self.json["bufferViews"][index]
        begin, length = view.get("byteOffset", 0), view["byteLength"]
        if view.get("buffer", 0) or "uri" in self.json["buffers"][0] or begin + length > len(self.binary):
            raise FileError("a bufferView lies outside of the file")
        return self.binary[begin : begin + length]

    def accessor(self, index: int) -> np.ndarray:
        """Return the numbers of an accessor (n, width), normalised ones as floats."""
        about = self.json["accessors"][index]
        if "sparse" in about or "bufferView" not in about:
            raise FileError("sparse and compressed accessors are not read: export plain ones")
        kind, width, count = np.dtype(KINDS[about["componentType"]]), WIDTHS[about["type"]], about["count"]
        data, begin = self.view(about["bufferView"]), about.get("byteOffset", 0)
        stride = self.json["bufferViews"][about["bufferView"]].get("byteStride", kind.itemsize * width)
        if count and begin + (count - 1) * stride + kind.itemsize * width > len(data):
            raise FileError(f"an accessor names {count:,} values, more than its bufferView holds")
        rows = np.ndarray((count, width), kind, data, begin, (stride, kind.itemsize))
        if kind.kind == "f" or not about.get("normalized"):
            return rows.astype(np.float64)
        return np.maximum(rows / float(np.iinfo(kind).max), -1)

    def objects(self, primitive: dict, count: int) -> "tuple[np.ndarray, dict[int, Box]]":
        """Return the number of each Gaussian's object, -1 for none, and the boxes by number."""
        sets = primitive.get("extensions", {}).get("EXT_mesh_features", {}).get("featureIds", [])
        if not sets or "attribute" not in sets[0]:
            return np.full(count, -1), {}
        chosen = sets[0]
        numbers = self.accessor(primitive["attributes"][f"_FEATURE_ID_{chosen['attribute']}"]).ravel().astype(int)
        numbers[numbers == chosen.get("nullFeatureId", -1)] = -1
        tables = self.json.get("extensions", {}).get("EXT_structural_metadata", {}).get("propertyTables", [])
        if "propertyTable" not in chosen or chosen["propertyTable"] >= len(tables):
            return numbers, {}
        return numbers, self.boxes(tables[chosen["propertyTable"]])

    def boxes(self, table: dict) -> "dict[int, Box]":
        count, columns = table["count"], table["properties"]
        names = self.texts(columns["name"], count) if "name" in columns else [f"object {i}" for i in range(count)]
        floats = {
            name: np.frombuffer(self.view(columns[name]["values"]), "<f4")[: width * count].reshape(count, -1)
            for name, width in (("center", 3), ("extent", 3), ("axes", 9))
            if name in columns
        }
        if not {"center", "extent"} <= floats.keys():
            return {number: Box(name, np.zeros(3), np.zeros(3)) for number, name in enumerate(names)}
        axes = floats.get("axes", np.tile(np.eye(3).ravel(), (count, 1))).reshape(count, 3, 3)
        boxed = zip(names, floats["center"], floats["extent"], axes, strict=True)
        return {number: Box(*numbers) for number, numbers in enumerate(boxed)}

    def texts(self, column: dict, count: int) -> "list[str]":
        kind = {"UINT8": "<u1", "UINT16": "<u2", "UINT32": "<u4", "UINT64": "<u8"}
        offsets = np.frombuffer(self.view(column["stringOffsets"]), kind[column.get("stringOffsetType", "UINT32")])
        data = self.view(column["values"])
        return [data[offsets[i] : offsets[i + 1]].decode("utf-8", "replace") for i in range(count)]


def kind_of(node: dict) -> str:
    """Return what drsplat says a node is, "" where it says nothing."""
    extras = node.get("extras")
    return str(extras.get("kind", "")) if isinstance(extras, dict) else ""


def node_matrix(node: dict) -> np.ndarray:
    """Return the 4x4 matrix of a glTF node."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(np.array([[w, x, y, z]], float))[0] * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


# ---- PLY

PLY_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


def read_ply(path: str, up: str = "-Y") -> Splats:
    """Read a 3DGS PLY, binary and little-endian, with objects where it has a column `object_id`."""
    rows = ply_rows(Path(path).read_bytes())
    needed = [
        "x",
        "y",
        "z",
        "opacity",
        *(f"{n}_{i}" for n, k in (("f_dc", 3), ("scale", 3), ("rot", 4)) for i in range(k)),
    ]
    missing = [name for name in needed if name not in rows.dtype.names]
    if missing:
        raise FileError(f"no Gaussians: the PLY has no {', '.join(missing)}")

    def columns(*names: str) -> np.ndarray:
        return np.stack([rows[name].astype(np.float64) for name in names], axis=1)

    positions = columns("x", "y", "z")
    quats = columns("rot_0", "rot_1", "rot_2", "rot_3")
    numbers = rows["object_id"].astype(int) if "object_id" in rows.dtype.names else np.full(len(rows), -1)
    opacities = 1 / (1 + np.exp(-np.clip(rows["opacity"].astype(np.float64), -80, 80)))
    boxes = {int(n): box_about(f"object {n}", positions[numbers == n]) for n in np.unique(numbers[numbers >= 0])}
    return Splats(
        positions, np.exp(columns("scale_0", "scale_1", "scale_2")),
        quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-30),
        opacities, 0.5 + SH_C0 * columns("f_dc_0", "f_dc_1", "f_dc_2"), numbers, boxes, UP[up],
    )  # fmt: skip


def ply_rows(data: bytes) -> np.ndarray:
    """Return the rows of the element `vertex`, which must be the first."""
    end = data.find(b"end_header\n")
    lines = data[: max(end, 0)].decode("ascii", "replace").splitlines()
    if end < 0 or lines[:1] != ["ply"] or "format binary_little_endian 1.0" not in lines:
        raise FileError("no PLY that is binary and little-endian")
    elements = [line.split() for line in lines if line.startswith("element ")]
    if not elements or elements[0][1] != "vertex":
        raise FileError("the first element of the PLY is not `vertex`: a compressed PLY? Convert it to a plain one")
    after = lines[lines.index(" ".join(elements[0])) + 1 :]
    kinds = []
    for words in map(str.split, after):
        if words[0] == "element":
            break
        if words[0] == "property":
            if words[1] not in PLY_KINDS:
                raise FileError(f"property {words[-1]}: expected a number, got {words[1]}")
            kinds.append((words[2], "<" + PLY_KINDS[words[1]]))
    count, kind = int(elements[0][2]), np.dtype(kinds)
    begin = end + len(b"end_header\n")
    if count * kind.itemsize > len(data) - begin:
        raise FileError(f"the header names {count:,} rows, more than the file holds")
    return np.frombuffer(data, kind, count, begin)


def box_about(name: str, points: np.ndarray) -> Box:
    """Return the box of all but a hundredth of the points at either end of each axis."""
    low, high = np.percentile(points, (1, 99), axis=0)
    return Box(name, (low + high) / 2, high - low)


# ---- into Blender


def import_file(path: str, up: str = "-Y") -> "bpy.types.Collection":
    """Import a GLB or PLY file as a collection and link it to the scene. up: of a PLY, which does not say it."""
    splats = read_glb(path) if path.lower().endswith(".glb") else read_ply(path, up)
    whole = bpy.data.collections.new(Path(path).stem)
    bpy.context.scene.collection.children.link(whole)
    root = bpy.data.objects.new(Path(path).stem, None)
    root.matrix_world = Matrix(splats.matrix.tolist())
    whole.objects.link(root)
    display = display_nodes()
    for number in sorted(set(np.unique(splats.objects).tolist())):
        box = splats.boxes.get(number, Box(f"object {number}", np.zeros(3), np.zeros(3)))
        name = REST if number < 0 else box.name
        part = bpy.data.collections.new(name)
        whole.children.link(part)
        cloud = points_of(splats, np.flatnonzero(splats.objects == number), name, number)
        cloud.modifiers.new("Gaussians", "NODES").node_group = display
        shapes = [cloud] if number < 0 or not box.extent.any() else [cloud, empty_of(box)]
        for shape in shapes:
            shape.parent = root
            part.objects.link(shape)
    if splats.marks:
        marks = bpy.data.collections.new("marks")
        whole.children.link(marks)
        for name, matrix in splats.marks:
            marks.objects.link(cube_of(name, matrix))
    return whole


def points_of(splats: Splats, rows: np.ndarray, name: str, number: int) -> "bpy.types.Object":
    """Return a mesh of vertices alone, with what is known of each Gaussian as attributes."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(rows))
    mesh.vertices.foreach_set("co", splats.positions[rows].astype(np.float32).ravel())
    linear = linear_from_display(np.clip(splats.colors[rows], 0, 1))
    columns = {
        "opacity": ("FLOAT", "value", splats.opacities[rows]),
        "radius": ("FLOAT", "value", np.cbrt(splats.scales[rows].prod(axis=1))),
        "scale": ("FLOAT_VECTOR", "vector", splats.scales[rows]),
        "rotation": ("FLOAT_VECTOR", "vector", euler_angles(splats.quats[rows])),
        "color": ("FLOAT_COLOR", "color", np.column_stack([linear, np.ones(len(rows))])),
    }
    for column, (kind, slot, values) in columns.items():
        mesh.attributes.new(column, kind, "POINT").data.foreach_set(slot, values.astype(np.float32).ravel())
    ids = mesh.attributes.new("object_id", "INT", "POINT")
    ids.data.foreach_set("value", np.full(len(rows), number, np.int32))
    mesh.update()
    return bpy.data.objects.new(name, mesh)


def empty_of(box: Box) -> "bpy.types.Object":
    """Return an empty with the shape and the name of a box."""
    matrix = np.eye(4)
    matrix[:3, :3] = box.axes.T * np.asarray(box.extent)
    matrix[:3, 3] = box.center
    return cube_of(f"{box.name} (box)", matrix)


def cube_of(name: str, matrix: np.ndarray) -> "bpy.types.Object":
    """Return an empty that shows a name, and a cube of side 1 as a matrix places it."""
    empty = bpy.data.objects.new(name, None)
    empty.empty_display_type, empty.empty_display_size, empty.show_name = "CUBE", 0.5, True
    empty.matrix_local = Matrix(matrix.tolist())
    return empty


def display_nodes() -> "bpy.types.NodeTree":
    """Return geometry nodes that show each Gaussian as an ellipsoid of one and a half standard deviations."""
    name = "Gaussians as ellipsoids"
    if name in bpy.data.node_groups:
        return bpy.data.node_groups[name]
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        if hasattr(group, "interface"):  # Blender 4 on
            group.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
        else:
            (group.inputs if side == "INPUT" else group.outputs).new("NodeSocketGeometry", "Geometry")
    new, link = group.nodes.new, group.links.new
    come, go, place = new("NodeGroupInput"), new("NodeGroupOutput"), new("GeometryNodeInstanceOnPoints")
    ball, paint, larger = new("GeometryNodeMeshIcoSphere"), new("GeometryNodeSetMaterial"), new("ShaderNodeVectorMath")
    ball.inputs["Subdivisions"].default_value = 2
    larger.operation = "SCALE"
    larger.inputs["Scale"].default_value = 1.5
    paint.inputs["Material"].default_value = display_material()
    solid = new("FunctionNodeCompare")
    solid.data_type, solid.operation = "FLOAT", "GREATER_THAN"
    solid.inputs[1].default_value = 0.2  # of the opacity: fainter ones are not shown
    link(named(group, "opacity", "FLOAT"), solid.inputs[0])
    link(named(group, "scale", "FLOAT_VECTOR"), larger.inputs[0])
    link(come.outputs[0], place.inputs["Points"])
    link(solid.outputs[0], place.inputs["Selection"])
    link(ball.outputs["Mesh"], paint.inputs["Geometry"])
    link(paint.outputs["Geometry"], place.inputs["Instance"])
    link(named(group, "rotation", "FLOAT_VECTOR"), place.inputs["Rotation"])
    link(larger.outputs[0], place.inputs["Scale"])
    link(place.outputs["Instances"], go.inputs[0])
    return group


def named(group: "bpy.types.NodeTree", attribute: str, kind: str) -> "bpy.types.NodeSocket":
    """Return the socket of a node that reads an attribute."""
    node = group.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = attribute
    return next(socket for socket in node.outputs if socket.enabled and socket.name == "Attribute")


def display_material() -> "bpy.types.Material":
    """Return a material that glows in each Gaussian's colour."""
    material = bpy.data.materials.new("Gaussians")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    color, glow, out = (
        nodes.new("ShaderNodeAttribute"),
        nodes.new("ShaderNodeEmission"),
        nodes.new("ShaderNodeOutputMaterial"),
    )
    color.attribute_type, color.attribute_name = "INSTANCER", "color"
    links.new(color.outputs["Color"], glow.inputs["Color"])
    links.new(glow.outputs["Emission"], out.inputs["Surface"])
    return material


# ---- numbers


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """Return the matrices (n, 3, 3) of unit quaternions w, x, y, z."""
    w, x, y, z = quats.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def euler_angles(quats: np.ndarray) -> np.ndarray:
    """Return Blender's XYZ Euler angles of unit quaternions, radians: what geometry nodes of all versions take."""
    m = rotation_matrices(quats)
    level = np.hypot(m[:, 0, 0], m[:, 1, 0])
    locked = level < 1e-6
    x = np.where(locked, np.arctan2(-m[:, 1, 2], m[:, 1, 1]), np.arctan2(m[:, 2, 1], m[:, 2, 2]))
    z = np.where(locked, 0, np.arctan2(m[:, 1, 0], m[:, 0, 0]))
    return np.stack([x, np.arctan2(-m[:, 2, 0], level), z], axis=1)


def linear_from_display(colors: np.ndarray) -> np.ndarray:
    """Return the linear values, which Blender's colour attributes hold, of sRGB ones."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


# ---- the menu


class ImportGaussians(bpy.types.Operator, ImportHelper):
    """Import Gaussians, with named objects as collections"""

    bl_idname = "import_scene.drsplat"
    bl_label = "Import Gaussians"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants it so)
    filename_ext = ".glb"
    filter_glob: bpy.props.StringProperty(default="*.glb;*.ply", options={"HIDDEN"})
    up: bpy.props.EnumProperty(
        name="Up in a PLY",
        description="What is up in a PLY, which does not say it; a GLB does",
        items=[("-Y", "-Y", "As 3DGS and COLMAP have it"), ("Y", "Y", ""), ("Z", "Z", "")],
    )

    def execute(self, context):
        try:
            import_file(self.filepath, self.up)
        except (FileError, OSError, KeyError, IndexError, TypeError, json.JSONDecodeError) as error:
            self.report({"ERROR"}, f"{Path(self.filepath).name}: {error}")
            return {"CANCELLED"}
        return {"FINISHED"}


def menu_entry(menu, context):
    menu.layout.operator(ImportGaussians.bl_idname, text="Gaussians with objects (.glb, .ply)")


def register():
    bpy.utils.register_class(ImportGaussians)
    bpy.types.TOPBAR_MT_file_import.append(menu_entry)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(menu_entry)
    bpy.utils.unregister_class(ImportGaussians)


if __name__ == "__main__":
    register()
