"""GLB as it is written and read: against a reader and a writer made from the specifications alone."""

import base64
import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import glb_files
import scene_files
from drsplat.errors import FormatError, InputError
from drsplat.formats import glb_writing
from drsplat.formats.axes import standing_up
from drsplat.formats.glb import names_in_glb
from drsplat.formats.known import lacks, parse_gaussians, write_scene
from drsplat.formats.scenes import read_gaussians
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import Annotation, LabelledScene, Thing
from drsplat.scene.similarity import similarity_of
from glb_files import SPLATTING, Read
from refusing import malformed, refused

NAMES = ("red mug", "<b>&amp;</b>", "кружка 😀", "a/../b\\c", "", 'quote " and\nline')
STORED = ("means", "quats", "scales", "opacities", "sh")


def made(rows: int = 40, degree: int = 3, seed: int = 0) -> Gaussians:
    return scene_files.random_gaussians(np.random.default_rng(seed), rows, degree)


def thing(name: str, number: int = -1, parent: int = -1) -> Thing:
    axes = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    return Thing(name, 0.75, np.array([1.0, 2, 3]), axes, np.array([0.5, 1, 2]), parent, None, number)


def with_objects(gaussians: Gaussians, names: tuple[str, ...] = NAMES) -> LabelledScene:
    owners = (np.arange(len(gaussians)) % (len(names) + 1) - 1).astype(np.int32)
    things = tuple(thing(name, 2 * place, 0) for place, name in enumerate(names))
    return LabelledScene(gaussians, "room", things, (thing("kitchen"),), owners)


def written(folder: Path, scene: LabelledScene) -> bytes:
    write_scene(folder / "scene.glb", scene)
    return (folder / "scene.glb").read_bytes()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_is_written_is_what_the_extension_says(degree, tmp_path):
    g = made(degree=degree)
    read = Read.of(written(tmp_path, LabelledScene(g)))
    assert_array_equal(read.attribute("POSITION"), g.means)
    assert_array_equal(read.attribute(f"{SPLATTING}:ROTATION"), g.quats[:, [1, 2, 3, 0]])
    assert_array_equal(read.attribute(f"{SPLATTING}:SCALE"), g.scales)
    assert_array_equal(read.attribute(f"{SPLATTING}:OPACITY"), g.opacities)
    for of_degree in range(degree + 1):
        for n in range(2 * of_degree + 1):
            written_sh = read.attribute(f"{SPLATTING}:SH_DEGREE_{of_degree}_COEF_{n}")
            assert_array_equal(written_sh, g.sh[:, of_degree**2 + n])
    assert len(read.primitive["attributes"]) == 5 + (degree + 1) ** 2
    assert read.document["extensionsUsed"] == [SPLATTING]
    assert "extensionsRequired" not in read.document
    assert read.primitive["mode"] == 0
    assert read.primitive["extensions"][SPLATTING]["kernel"] == "ellipse"
    accessor = read.document["accessors"][read.primitive["attributes"]["POSITION"]]
    assert_array_equal(np.float32(accessor["min"]), g.means.min(axis=0))
    assert_array_equal(np.float32(accessor["max"]), g.means.max(axis=0))


def test_points_have_the_colours_of_the_splats_in_linear_light(tmp_path):
    """A third of sRGB's range is 0.0908 of its light, by the curve of IEC 61966-2-1."""
    g = made(3, 0)
    shown = np.float32([[1 / 3, 0, 1], [2, -1, 0.02], [0.5, 0.5, 0.5]])
    g = replace(g, sh=((shown - 0.5) / 0.28209479)[:, None].astype(np.float32), opacities=np.float32([0, 0.5, 1]))
    colors = Read.of(written(tmp_path, LabelledScene(g))).attribute("COLOR_0")
    expected = [[23, 0, 255, 0], [255, 0, 0, 128], [55, 55, 55, 255]]
    assert_allclose(colors.astype(int), expected, atol=1)


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_it_comes_back_to_the_bit(degree, tmp_path):
    scene = replace(with_objects(made(degree=degree)), up=(0.3, -0.9, 0.4), query="mug")
    scene = replace(scene, relevancy=np.linspace(-1, 1, 40, dtype=np.float32))
    written(tmp_path, scene)
    back = read_gaussians(tmp_path / "scene.glb")
    for name in STORED:
        assert_array_equal(getattr(back, name), getattr(scene.gaussians, name))
    assert back.fingerprint == scene.gaussians.fingerprint
    assert_array_equal(back.extra["relevancy"], scene.relevancy)
    assert scene.object_of is not None
    assert_array_equal(back.extra["object_id"], np.where(scene.object_of < 0, -1, 2 * scene.object_of))


def test_names_and_numbers_of_objects_come_back(tmp_path):
    scene = with_objects(made())
    read = Read.of(written(tmp_path, scene))
    assert scene.object_of is not None
    assert read.object_names() == [None if row < 0 else NAMES[row] for row in scene.object_of]
    assert names_in_glb(tmp_path / "scene.glb") == [(2 * place, name) for place, name in enumerate(NAMES)]
    table = read.table(0)
    assert table["number"] == [2 * place for place in range(len(NAMES))]
    assert table["num_gaussians"] == np.bincount(scene.object_of + 1)[1:].tolist()
    assert set(table["score"]) == {np.float32(0.75)}
    assert table["center"][0].tolist() == [1, 2, 3]
    assert table["extent"][0].tolist() == [0.5, 1, 2]
    columns = table["axes"][0].reshape(3, 3)  # a matrix is stored column by column
    assert_array_equal(columns, scene.things[0].axes)
    assert read.table(1)["name"] == ["kitchen"]
    assert table["parent"] == [0] * len(NAMES)


def test_embeddings_go_along_where_objects_have_some(tmp_path):
    scene = with_objects(made(), ("a", "b"))
    vector = np.float32([0.6, 0.8, 0])
    scene = replace(scene, things=(replace(scene.things[0], embedding=vector), scene.things[1]), encoder="clip")
    embeddings = Read.of(written(tmp_path, scene)).table(0)["embedding"]
    assert_array_equal(embeddings, [vector, np.zeros(3)])


def test_the_answer_to_a_query_is_a_property_of_every_splat(tmp_path):
    relevancy = np.linspace(0, 1, 40, dtype=np.float32)
    matches = (thing("match 0"), thing("match 1"))
    scene = LabelledScene(made(), query="red mug", relevancy=relevancy, matches=matches)
    read = Read.of(written(tmp_path, scene))
    assert_array_equal(read.attribute("_RELEVANCY"), relevancy)
    metadata = read.document["extensions"]["EXT_structural_metadata"]
    (attribute,) = metadata["propertyAttributes"]
    assert attribute["properties"]["relevancy"]["attribute"] == "_RELEVANCY"
    assert read.primitive["extensions"]["EXT_structural_metadata"]["propertyAttributes"] == [0]
    assert "red mug" in metadata["schema"]["classes"][attribute["class"]]["properties"]["relevancy"]["description"]


def test_matches_and_annotations_are_named_nodes_at_their_boxes(tmp_path):
    match, axes = thing("red mug"), np.diag([1.0, 1, -1])  # left-handed: the same box as a right-handed one
    notes = (
        Annotation.at("here", [1.0, 2, 3]),
        Annotation.box("from Delft", np.array([4.0, 5, 6]), axes, np.array([1.0, 2, 3])),
    )
    scene = LabelledScene(made(), query="mug", matches=(match,), annotations=notes, up=(0.0, 0.0, 1.0))
    document = Read.of(written(tmp_path, scene)).document
    nodes = {node["name"]: node for node in document["nodes"]}
    box = nodes["red mug"]
    assert box["translation"] == [1, 2, 3]
    assert box["scale"] == [0.5, 1, 2]
    assert box["extras"] == {"kind": "match", "score": 0.75, "query": "mug"}
    assert_allclose(similarity_of(matrix_of(box, scaled=False)).rotation.T, match.axes, atol=1e-12)
    assert nodes["here"]["translation"] == [1, 2, 3]
    assert "rotation" not in nodes["here"]
    assert abs(np.linalg.norm(nodes["from Delft"]["rotation"]) - 1) < 1e-12
    assert [document["nodes"][child]["name"] for child in document["nodes"][0]["children"]] == [
        "splats", "matches", "annotations",
    ]  # fmt: skip


def matrix_of(node: dict, scaled: bool = True) -> np.ndarray:
    """Return the matrix of a node by the formulas of the specification."""
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    if scaled:
        matrix[:3, :3] *= node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


@pytest.mark.parametrize(
    "up", [(0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.3, -0.9, 0.1), (-0.1, 0.98, 0.05)]
)
def test_what_is_up_is_up_in_gltf(up, tmp_path):
    scene = LabelledScene(made(), up=up)
    root = Read.of(written(tmp_path, scene)).document["nodes"][0]
    rotation = matrix_of(root)[:3, :3]
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    assert_allclose(rotation @ np.array(up) / np.linalg.norm(up), [0, 1, 0], atol=1e-7)


def test_a_scene_of_photos_is_turned_by_half_about_x():
    assert_array_equal(standing_up(np.array([0.0, -1.0, 0.0])), np.diag([1.0, -1, -1]))


def test_positions_far_from_zero_stay_exact(tmp_path):
    origin = np.array([500_000.25, 4_000_000.5, 100.125])
    g = replace(made(), origin=origin)
    node = Read.of(written(tmp_path, LabelledScene(g))).document["nodes"][1]
    assert node["translation"] == origin.tolist()
    back = read_gaussians(tmp_path / "scene.glb")
    assert_array_equal(back.origin, origin)
    assert_array_equal(back.means, g.means)


def test_the_mark_of_an_antialiased_scene_comes_back(tmp_path):
    g = replace(made(), antialiased=True)
    written(tmp_path, LabelledScene(g))
    back = read_gaussians(tmp_path / "scene.glb")
    assert back.antialiased
    assert back.fingerprint == g.fingerprint
    write_scene(tmp_path / "plain.glb", LabelledScene(made()))
    assert not read_gaussians(tmp_path / "plain.glb").antialiased


@pytest.mark.slow
@pytest.mark.parametrize(("count", "component"), [(3, 5123), (65_535, 5123), (65_536, 5126), (100_000, 5126)])
def test_any_number_of_objects_is_told_apart(count, component, tmp_path):
    g = made(1000, 0)
    owners = np.linspace(-1, count - 1, 1000).astype(np.int32)
    one = thing("x")
    things = tuple(replace(one, name=f"object {number}", number=number) for number in range(count))
    read = Read.of(written(tmp_path, LabelledScene(g, things=things, object_of=owners)))
    accessor = read.document["accessors"][read.primitive["attributes"]["_FEATURE_ID_0"]]
    assert accessor["componentType"] == component
    assert read.object_names() == [None if row < 0 else f"object {row}" for row in owners]
    assert_array_equal(read_gaussians(tmp_path / "scene.glb").extra["object_id"], owners)


def test_an_empty_scene_is_refused(tmp_path):
    nothing = made().subset(np.empty(0, np.int64))
    with refused("no Gaussians to write"):
        write_scene(tmp_path / "scene.glb", LabelledScene(nothing))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", STORED)
def test_numbers_that_are_none_are_refused(name, tmp_path):
    column = getattr(made(), name).copy()
    column.reshape(40, -1)[7, 0] = np.nan
    with refused(r"1 of 40 rows have .*; the first is row 7\."):
        write_scene(tmp_path / "scene.glb", LabelledScene(replace(made(), **{name: column})))
    relevancy = np.where(np.arange(40) == 3, np.float32(np.inf), np.float32(0))
    with refused(r"relevancies: .*inf in row 3"):
        write_scene(tmp_path / "scene.glb", LabelledScene(made(), relevancy=relevancy))


def test_what_is_too_large_for_the_format_is_refused_before_it_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(glb_writing, "MAX_FILE_BYTES", 10_000)
    with refused(r"scene\.glb would have .* GB, and a GLB holds up to"):
        write_scene(tmp_path / "scene.glb", LabelledScene(made(100)))
    assert not list(tmp_path.iterdir())


def test_rows_are_made_on_their_way_to_the_disk(tmp_path):
    """The file has 11 MB; nothing of that size is held."""
    g = made(50_000, 3)
    size = len(g) * (3 + 4 + 3 + 1 + 48 + 1) * 4
    tracemalloc.start()
    try:
        write_scene(tmp_path / "scene.glb", LabelledScene(g))
        assert tracemalloc.get_traced_memory()[1] < size / 2
    finally:
        tracemalloc.stop()
    assert (tmp_path / "scene.glb").stat().st_size > size


def test_what_a_format_cannot_hold_is_said():
    scene = replace(with_objects(made()), relevancy=np.zeros(40, np.float32), matches=(thing("m"),))
    assert lacks(".glb", scene) == ()
    assert lacks(".ply", scene) == (".ply keeps no boxes of matches",)  # names lie in a file beside it
    assert len(lacks(".spz", scene)) == 4


# --- reading ---


def outcome(content: bytes, suffix: str = ".glb") -> Gaussians:
    return parse_gaussians(memoryview(content), suffix)


def half_turned(g: Gaussians) -> Gaussians:
    turn = np.diag([1.0, -1, -1, 1])
    return similarity_of(turn).moved(g)


def assert_near(ours: Gaussians, expected: Gaussians, atol: float = 1e-6) -> None:
    signs = np.sign((ours.quats * expected.quats).sum(axis=1, keepdims=True))
    assert_allclose(ours.positions, expected.positions, atol=atol)
    assert_allclose(ours.quats * signs, expected.quats, atol=atol)
    for name in ("scales", "opacities", "sh"):
        assert_allclose(getattr(ours, name), getattr(expected, name), atol=atol)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_file_of_others_is_turned_into_the_axes_of_a_ply(degree):
    """y up becomes y down; harmonics turn along."""
    g = made(degree=degree)
    assert_near(outcome(glb_files.glb_bytes(half_turned(g))), g)


def test_integers_are_shares_of_one():
    g = made()
    g = replace(g, scales=np.minimum(g.scales, 1))
    assert_near(outcome(glb_files.small_glb_bytes(half_turned(g))), g, atol=3e-3)


def test_the_transform_of_a_node_is_applied():
    g = made()
    node = {"translation": [1.0, 2, 3], "rotation": [0.5, 0.5, 0.5, 0.5], "scale": [2.0, 2, 2]}
    expected = similarity_of(np.diag([1.0, -1, -1, 1]) @ matrix_of(node)).moved(g)
    assert_near(outcome(glb_files.glb_bytes(g, node)), expected)
    as_matrix = {"matrix": matrix_of(node).T.ravel().tolist()}
    assert_near(outcome(glb_files.glb_bytes(g, as_matrix)), expected)


def test_primitives_stand_one_behind_the_other():
    first, second = made(20, 1, 1), made(30, 3, 2)
    building = glb_files.Building()
    attributes = [glb_files.splat_attributes(building, half_turned(g)) for g in (first, second)]
    read = outcome(glb_files.finish(building, *attributes))
    assert len(read) == 50
    assert_near(read.subset(np.arange(20, 50)), second)
    assert_allclose(read.sh[:20, :4], first.sh, atol=1e-6)
    assert not read.sh[:20, 4:].any()


@pytest.mark.parametrize("version", [2, 3, 4])
def test_an_spz_within_is_read(version):
    """What is in it has the axes of glTF, which are those that SPZ has by itself."""
    g = made(degree=2)
    spz = scene_files.spz_bytes(g, version)
    assert_near(outcome(glb_files.spz_glb_bytes(g, spz)), outcome(spz, ".spz"))


def test_gltf_with_its_buffer_beside_it_or_in_it(tmp_path):
    g = made(degree=1)
    document, binary = glb_files.parts_of(glb_files.glb_bytes(half_turned(g)))
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    assert_near(outcome(json.dumps(document).encode(), ".gltf"), g)
    document["buffers"][0]["uri"] = "my%20splats.bin"
    (tmp_path / "my splats.bin").write_bytes(binary)
    (tmp_path / "scene.gltf").write_text(json.dumps(document))
    assert_near(read_gaussians(tmp_path / "scene.gltf"), g)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "scene.gltf").write_text(json.dumps(document))
    with refused("no such file"):
        read_gaussians(tmp_path / "other" / "scene.gltf")


@pytest.mark.parametrize(
    "uri",
    ["../scene.bin", "/etc/passwd", "http://example.org/a.bin", "file:///etc/passwd", "a%2F..%2Fb", "..", "c:\\a", ""],
)
def test_nothing_elsewhere_is_read(uri, tmp_path):
    document, binary = glb_files.parts_of(glb_files.glb_bytes(made()))
    (tmp_path / "scene.bin").write_bytes(binary)
    document["buffers"][0]["uri"] = uri
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "scene.gltf").write_text(json.dumps(document))
    with pytest.raises((FormatError, InputError), match=r"right beside the document|file name|a folder"):
        read_gaussians(tmp_path / "in" / "scene.gltf")


def changed(change: object, g: Gaussians | None = None) -> bytes:
    """A good file with its document changed."""
    document, binary = glb_files.parts_of(glb_files.glb_bytes(made() if g is None else g))
    change(document)
    return glb_files.glb_of(document, binary)


def put(document: dict, path: str, value: object) -> None:
    *above, last = [int(part) if part.isdigit() else part for part in path.split("/")]
    for part in above:
        document = document[part]
    document[last] = value


PRIMITIVE = "meshes/0/primitives/0"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("accessors/0/count", 10**12, r"1,000,000,000,000 Gaussians do not fit"),
        ("accessors/0/count", 41, r"41 rows do not fit into"),
        ("accessors/1/count", 39, r"with \[39, 40\] rows"),
        ("accessors/0/count", -1, "expected a whole number"),
        ("accessors/0/bufferView", 99, "expected a whole number from 0 to 19"),
        ("accessors/0/sparse", {"count": 1}, "sparse"),
        ("accessors/1/componentType", 5125, "ROTATION: expected VEC4"),
        ("bufferViews/0/byteLength", 10**9, "ends at byte"),
        ("bufferViews/0/byteStride", 4, "rows of 12 bytes in steps of 4"),
        ("buffers/0/byteLength", 10**9, "truncated"),
        ("nodes/0/scale", [1, 2, 1], "the node of the splats"),
        ("nodes/0/scale", [-1, 1, 1], "the node of the splats"),
        ("nodes/0/children", [0], "in two places, or within itself"),
        ("nodes/0/rotation", [0, 0, 0, 0], "beyond all numbers"),
        ("nodes/0/mesh", 7, "mesh"),
        ("extensionsRequired", ["EXT_meshopt_compression"], "needs the extension 'EXT_meshopt_compression'"),
        (f"{PRIMITIVE}/mode", 4, "mode 4"),
        (f"{PRIMITIVE}/extensions", {}, "no primitive with KHR_gaussian_splatting"),
        (f"{PRIMITIVE}/extensions/{SPLATTING}/colorSpace", "lin_rec709_display", "linear light"),
        (f"{PRIMITIVE}/extensions/{SPLATTING}/colorSpace", "p3", "colours of 'p3'"),
        (f"{PRIMITIVE}/extensions/{SPLATTING}/kernel", "beta", "kernel 'beta'"),
        (f"{PRIMITIVE}/attributes/{SPLATTING}:SH_DEGREE_3_COEF_7", 0, None),
        ("asset/version", "1.0", "version '1.0'"),
    ],
)
def test_what_cannot_be_read_is_said(path, value, message):
    content = changed(lambda document: put(document, path, value))
    if message is None:
        assert len(outcome(content)) == 40
        return
    with malformed(message):
        outcome(content)


def test_a_degree_of_harmonics_is_whole_or_not_there():
    def without(document):
        del document["meshes"][0]["primitives"][0]["attributes"][f"{SPLATTING}:SH_DEGREE_2_COEF_1"]

    with malformed("15 coefficients of harmonics"):
        outcome(changed(without))


def test_logarithms_of_scales_are_refused_with_their_cure():
    g = made()
    logs = replace(g, scales=np.log(g.scales))
    with malformed(r"40 of 40 rows have negative scales.*splat-transform"):
        outcome(glb_files.glb_bytes(logs))


def test_rows_that_are_no_gaussians_are_named():
    g = made()
    opacities = g.opacities.copy()
    opacities[5] = np.nan
    with malformed(r"1 of 40 rows have opacities .* the first is row 5"):
        outcome(glb_files.glb_bytes(replace(g, opacities=opacities)))


@pytest.mark.slow
def test_bytes_that_are_named_many_times_over_do_not_unfold():
    """Three thousand primitives of the same hundred thousand rows, in a file of some hundred kilobytes."""

    def many(document):
        primitives = document["meshes"][0]["primitives"]
        primitives *= 3000

    tracemalloc.start()
    try:
        with malformed("do not fit into"):
            outcome(changed(many, made(500)))
        assert tracemalloc.get_traced_memory()[1] < 32 << 20
    finally:
        tracemalloc.stop()


def test_a_turned_root_is_turned(tmp_path):
    """Another program may turn what was written: then the file's own transforms hold."""
    g = made()
    document, binary = glb_files.parts_of(written(tmp_path, LabelledScene(g)))
    document["nodes"][0]["rotation"] = [0, 0, 0, 1]
    assert_near(outcome(glb_files.glb_of(document, binary)), half_turned(g))


def test_names_that_do_not_fit_their_bytes_are_refused(tmp_path):
    document, binary = glb_files.parts_of(written(tmp_path, with_objects(made())))
    column = document["extensions"]["EXT_structural_metadata"]["propertyTables"][0]["properties"]["name"]
    column["values"], column["stringOffsets"] = column["stringOffsets"], column["values"]
    (tmp_path / "bad.glb").write_bytes(glb_files.glb_of(document, binary))
    with malformed(r"names of the objects|does not fit"):
        names_in_glb(tmp_path / "bad.glb")


def test_a_mesh_is_no_scene_and_damage_is_no_mesh(tmp_path):
    document, binary = glb_files.parts_of(glb_files.glb_bytes(made()))
    path = tmp_path / "scene.glb"
    path.write_bytes(glb_files.glb_of(document, binary)[:-8])
    with malformed("truncated"):
        read_gaussians(path)
    document["extensionsUsed"] = []
    document["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 0}}]
    path.write_bytes(glb_files.glb_of(document, binary))
    with refused("got a mesh, expected a scene of Gaussians"):
        read_gaussians(path)
