"""The add-on for Blender: what it reads of a GLB and a PLY, and what Blender itself makes of it, where there is one.

The GLB is made here by hand, from the specifications.
"""

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from drsplat.scene.gaussians import SH_C0, rotation_matrices
from glb_files import SPLATTING, Building, finish, glb_of, parts_of, splat_attributes
from places import SUPPORT
from scenes import random_gaussians

ADDON = Path(__file__).resolve().parents[2] / "integrations/blender/drsplat_import.py"
SESSION = SUPPORT / "blender_session.py"


@pytest.fixture
def addon(monkeypatch) -> Any:
    """The module of the add-on, beside stand-ins for Blender's own modules."""
    stand_ins = {
        "bpy": {
            "types": type("types", (), {"Operator": type("Operator", (), {})}),
            "props": type("props", (), {"StringProperty": dict, "EnumProperty": dict}),
        },
        "bpy_extras": {},
        "bpy_extras.io_utils": {"ImportHelper": type("ImportHelper", (), {})},
        "mathutils": {"Matrix": list},
    }
    for name, contents in stand_ins.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("drsplat_import", ADDON)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "drsplat_import", module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def gaussians() -> ds.Gaussians:
    return random_gaussians(6, seed=3)


def glb_bytes(gaussians: ds.Gaussians, **changes: Any) -> bytes:
    """Two objects, `red mug` of rows 0 to 2 and `Tür` of rows 3 and 4; row 5 is of none. Nodes are turned and moved."""
    building = Building()
    scales = changes.pop("scales", gaussians.scales)
    attributes = splat_attributes(building, gaussians)
    attributes["_FEATURE_ID_0"] = building.attribute(np.uint16([0, 0, 0, 1, 1, 65535]))
    attributes[f"{SPLATTING}:SCALE"] = building.attribute(scales)
    opacities = np.rint(gaussians.opacities * 255).astype(np.uint8)
    attributes[f"{SPLATTING}:OPACITY"] = building.attribute(opacities, normalized=True)
    turned = [[0, 1, 0, -1, 0, 0, 0, 0, 1], [1, 0, 0, 0, 1, 0, 0, 0, 1]]
    columns = {"center": [[1, 2, 3], [4, 5, 6]], "extent": [[2, 4, 6], [1, 1, 1]], "axes": turned}
    properties = {name: {"values": building.view(np.float32(rows).tobytes())} for name, rows in columns.items()}
    offsets = building.view(np.uint32([0, 7, 11]).tobytes())
    properties["name"] = {"values": building.view("red mugTür".encode()), "stringOffsets": offsets}
    document, binary = parts_of(finish(building, attributes))
    features = {"featureIds": [{"featureCount": 2, "attribute": 0, "propertyTable": 0, "nullFeatureId": 65535}]}
    document["meshes"][0]["primitives"][0]["extensions"]["EXT_mesh_features"] = features
    table = {"class": "object", "count": 2, "properties": properties}
    document["extensions"] = {"EXT_structural_metadata": {"propertyTables": [table]}}
    document["nodes"] = [
        {"rotation": [1, 0, 0, 0], "children": [1, 2]},
        {"mesh": 0, "translation": [0, 0, 10]},
        {"name": "matches", "children": [3]},
        {"name": "mug", "extras": {"kind": "match"}, "translation": [1, 2, 3], "scale": [2, 4, 6]},
    ]
    return glb_of(document | changes, binary)


def test_a_glb_gives_gaussians_objects_and_marks(addon, gaussians, tmp_path):
    (tmp_path / "room.glb").write_bytes(glb_bytes(gaussians))
    splats = addon.read_glb(str(tmp_path / "room.glb"))
    assert_array_equal(splats.positions, gaussians.means)
    assert_array_equal(splats.scales, gaussians.scales)
    assert_array_equal(splats.quats, gaussians.quats)
    assert_allclose(splats.opacities, gaussians.opacities, atol=0.5 / 255 + 1e-6)
    assert_allclose(splats.colors, 0.5 + SH_C0 * gaussians.sh[:, 0], atol=1e-6)
    assert splats.objects.tolist() == [0, 0, 0, 1, 1, -1]
    assert [box.name for box in splats.boxes.values()] == ["red mug", "Tür"]
    assert splats.boxes[0].axes.tolist() == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    # y down, the half turn of the node and 10 ahead of it: the file's (0, 0, 10) is 10 behind in glTF, +y in Blender
    assert_allclose(splats.matrix, [[1, 0, 0, 0], [0, 0, 1, 10], [0, -1, 0, 0], [0, 0, 0, 1]], atol=1e-12)
    [(name, matrix)] = splats.marks
    assert name == "mug"
    assert_allclose(matrix @ [0.5, 0.5, 0.5, 1], [2, 6, -4, 1])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"scales": -np.ones((6, 3), np.float32)}, "negative scales"),
        ({"meshes": [{"primitives": [{"attributes": {}}]}]}, "no Gaussians"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 10**9}] * 20}, "outside of the file"),
        ({"nodes": [{"children": [0]}]}, "no Gaussians"),
    ],
)
def test_a_glb_that_cannot_be_meant_is_refused(addon, gaussians, tmp_path, changes, reason):
    (tmp_path / "bad.glb").write_bytes(glb_bytes(gaussians, **changes))
    with pytest.raises(addon.FileError, match=reason):
        addon.read_glb(str(tmp_path / "bad.glb"))


def test_counts_are_checked_before_they_are_believed(addon, gaussians, tmp_path):
    whole = glb_bytes(gaussians)
    for end in (0, 11, 19, 40, len(whole) - 200):
        (tmp_path / "cut.glb").write_bytes(whole[:end])
        with pytest.raises(addon.FileError):
            addon.read_glb(str(tmp_path / "cut.glb"))
    ds.write_gaussians(tmp_path / "room.ply", gaussians)
    ply = (tmp_path / "room.ply").read_bytes().replace(b"vertex 6", b"vertex 7")
    (tmp_path / "room.ply").write_bytes(ply)
    with pytest.raises(addon.FileError, match="7 rows, more than the file holds"):
        addon.read_ply(str(tmp_path / "room.ply"))


def test_a_ply_of_drsplat_gives_the_same_gaussians(addon, gaussians, tmp_path):
    ids = {"object_id": np.int32([7, 7, 7, 2, 2, -1])}
    ds.write_gaussians(tmp_path / "room.ply", gaussians, ids)
    splats = addon.read_ply(str(tmp_path / "room.ply"), "Z")
    again = ds.read_gaussians(tmp_path / "room.ply")
    assert_array_equal(splats.positions, again.means)
    assert_allclose(splats.scales, again.scales, rtol=1e-5)
    assert_allclose(splats.quats, again.quats, atol=1e-6)
    assert_allclose(splats.opacities, again.opacities, atol=1e-6)
    assert_allclose(splats.colors, 0.5 + SH_C0 * again.sh[:, 0], atol=1e-6)
    assert splats.objects.tolist() == [7, 7, 7, 2, 2, -1]
    assert sorted(box.name for box in splats.boxes.values()) == ["object 2", "object 7"]
    assert_array_equal(splats.matrix, np.eye(4))


def test_euler_angles_are_of_the_same_rotation(addon):
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(50, 4))
    quats[0] = [1, 0, -1, 0]  # looks straight up: two of the axes fall together
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    for quat, (x, y, z) in zip(quats, addon.euler_angles(quats), strict=True):
        (cx, cy, cz), (sx, sy, sz) = np.cos([x, y, z]), np.sin([x, y, z])
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        assert_allclose(about_z @ about_y @ about_x, rotation_matrices(quat[None])[0], atol=1e-9)


def blender_with_numpy() -> str:
    """Return the path of Blender, "" where there is none or its Python lacks NumPy."""
    path = shutil.which("blender") or ""
    if not path:
        return ""
    command = [path, "--background", "--factory-startup", "--python-exit-code", "7", "--python-expr", "import numpy"]
    return path if subprocess.run(command, capture_output=True, check=False).returncode == 0 else ""


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["glb", "ply"])
def test_blender_shows_objects_as_named_collections(kind, gaussians, tmp_path):
    blender = blender_with_numpy()
    if not blender:
        pytest.skip("no blender with NumPy is installed")
    scene = tmp_path / f"room.{kind}"
    if kind == "glb":
        scene.write_bytes(glb_bytes(gaussians))
    else:
        ds.write_gaussians(scene, gaussians, {"object_id": np.int32([0, 0, 0, 1, 1, -1])})
    command = [blender, "--background", "--factory-startup", "--python-exit-code", "7", "--python", str(SESSION), "--"]
    done = subprocess.run([*command, str(ADDON), str(scene), "-Y"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout.partition("RESULT")[2].partition("\n")[0])
    names = ["rest", "red mug", "Tür", "marks"] if kind == "glb" else ["rest", "object 0", "object 1"]
    assert (result["name"], list(result["parts"])) == ("room", names)
    ahead = [0.0, 10, 0] if kind == "glb" else [0.0, 0, 0]
    stood = gaussians.means @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) + ahead
    for name, rows in (("rest", [5]), (names[1], [0, 1, 2]), (names[2], [3, 4])):
        cloud = result["parts"][name][name]
        assert_allclose(cloud["world"], stood[rows], atol=1e-5)
        assert_allclose(cloud["scale"], gaussians.scales[rows], rtol=1e-5)
        assert_allclose(cloud["opacity"], gaussians.opacities[rows], atol=0.5 / 255 + 1e-6)
        assert_allclose(cloud["radius"], np.cbrt(gaussians.scales[rows].prod(axis=1)), rtol=1e-5)
        assert cloud["instances"] == (gaussians.opacities[rows] > 0.2).sum()
        assert len(cloud["color"][0]) == 4
    box = np.array(result["parts"][names[1]][f"{names[1]} (box)"]["matrix"])
    if kind == "glb":  # the first axis of the box is the file's y, 2 long, which is down in Blender
        assert_allclose(box[:3, 0], [0, 0, -2], atol=1e-6)
        assert_allclose(box[:3, 3], [1, 13, -2], atol=1e-6)
        assert result["parts"]["marks"]["mug"]["type"] == "EMPTY"
