"""ScanNet's files and label sets: what they say, and damage."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drsplat.errors import FormatError, InputError, MismatchError
from drsplat.evaluation.scannet import BUILT_IN, LabelSet, label_set
from drsplat.formats.scannet import (
    check_vertices,
    raw_category_labels,
    read_label_table,
    read_scannet_instances,
    read_scannet_labels,
    scene_file,
)
from mutations import quota, seeded, survivors
from refusing import malformed, refused

MUTANTS = quota(3_000)
SEGMENTS = {"sceneId": "s", "segIndices": [7, 7, 3, 9, 3, 9]}
AGGREGATION = {
    "segGroups": [
        {"id": 0, "objectId": 0, "segments": [3], "label": "office chair"},
        {"id": 1, "objectId": 1, "segments": [9, 12], "label": "thing of no table"},
    ]
}
TABLE = "id\traw_category\tcategory\tnyu40id\n5\toffice chair\tchair\t5\n1\twall\twall\t1\n"


def ply_bytes(with_faces: bool = True) -> bytes:
    """Six vertices as ScanNet writes them."""
    row = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4), ("label", "<u2")])
    rows = np.zeros(6, row)
    rows["xyz"], rows["label"] = np.arange(18).reshape(6, 3), [1, 2, 5, 0, 5, 40]
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 6"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue", "alpha")]
    lines += ["property ushort label", f"element face {int(with_faces)}"]
    lines += ["property list uchar int vertex_indices", "end_header", ""]
    face = b"\x03" + np.arange(3, dtype="<i4").tobytes() if with_faces else b""
    return "\n".join(lines).encode() + rows.tobytes() + face


@pytest.fixture
def scene(tmp_path) -> Path:
    folder = tmp_path / "scene0000_00"
    folder.mkdir()
    stem = folder / "scene0000_00"
    Path(f"{stem}_vh_clean_2.labels.ply").write_bytes(ply_bytes())
    Path(f"{stem}_vh_clean_2.0.010000.segs.json").write_text(json.dumps(SEGMENTS))
    Path(f"{stem}.aggregation.json").write_text(json.dumps(AGGREGATION))
    (folder / "points3d.ply").write_bytes(ply_bytes(with_faces=False))
    (folder / "scannetv2-labels.combined.tsv").write_text(TABLE)
    return folder


def test_files_are_read(scene):
    cloud = read_scannet_labels(scene_file(scene, "_vh_clean_2.labels.ply"))
    assert_array_equal(cloud.labels, [1, 2, 5, 0, 5, 40])
    assert_array_equal(cloud.positions, np.arange(18).reshape(6, 3))
    instances = read_scannet_instances(scene_file(scene, ".segs.json"), scene_file(scene, ".aggregation.json"))
    assert_array_equal(instances.objects, [-1, -1, 0, 1, 0, 1])
    check_vertices(cloud, instances, "here")
    table = read_label_table(scene / "scannetv2-labels.combined.tsv")
    assert_array_equal(raw_category_labels(instances, table), [0, 0, 5, 0, 5, 0])


def test_segments_of_another_mesh_are_refused(scene):
    cloud = read_scannet_labels(scene_file(scene, "_vh_clean_2.labels.ply"))
    path = scene_file(scene, ".segs.json")
    path.write_text('{"segIndices": [1]}')
    instances = read_scannet_instances(path, scene_file(scene, ".aggregation.json"))
    with pytest.raises(MismatchError, match="vh_clean_2"):
        check_vertices(cloud, instances, "here")


def test_files_that_are_not_there_are_named(scene):
    with refused(r"scene0000_00\.txt.*found none"):
        scene_file(scene, ".txt")
    with refused("folder of a ScanNet scene"):
        scene_file(scene / "x", ".txt")
    for read in (read_scannet_labels, read_label_table):
        with refused("no such file"):
            read(scene / "nothing")


def edited(group: int, **fields: object) -> str:
    groups = [dict(entry) for entry in AGGREGATION["segGroups"]]
    groups[group] |= fields
    return json.dumps({"segGroups": groups})


@pytest.mark.parametrize(
    ("ending", "content", "message"),
    [
        (".aggregation.json", "[]", "segGroups"),
        (".aggregation.json", '{"segGroups": [1]}', "segGroups: 0: expected an object"),
        (".aggregation.json", edited(1, label=3), "segGroups: 1: label"),
        (".aggregation.json", edited(1, segments=[1.5]), r"segGroups: 1 \('thing.*: segments"),
        (".aggregation.json", edited(0, segments=[2**64]), "segGroups: 0 .*: segments"),
        (".segs.json", '{"segIndices": [true]}', "segIndices"),
        (".segs.json", '{"segIndices": [1e3]}', "segIndices"),
        (".segs.json", '{"segIndices": [9223372036854775808]}', "segIndices"),
    ],
)
def test_wrong_instances_are_named(ending, content, message, scene):
    path = scene_file(scene, ending)
    path.write_text(content)
    with malformed(message) as error:
        read_scannet_instances(scene_file(scene, ".segs.json"), scene_file(scene, ".aggregation.json"))
    assert path.name in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"ushort label", b"ushort other", "no property 'label'"),
        (b"float x", b"float u", "vertex has no x"),
        (b"element vertex 6", b"element vertex 7", "truncated"),
        (b"ply\n", b"", "not a PLY file"),
    ],
)
def test_wrong_clouds_are_named(old, new, message, tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(ply_bytes().replace(old, new, 1))
    with malformed(f"a.ply: .*{message}"):
        read_scannet_labels(path)


def test_positions_must_be_finite(tmp_path):
    path, data = tmp_path / "a.ply", ply_bytes()
    start = data.index(b"end_header\n") + 11 + 2 * 18  # the third vertex
    path.write_bytes(data[:start] + np.float32(np.nan).tobytes() + data[start + 4 :])
    with malformed("vertex 2: expected a finite"):
        read_scannet_labels(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: expected columns"),
        ("id\tname\n1\ta\n", "line 1: expected columns"),
        ("id\traw_category\nx\ta\n", "line 2: id"),
        ("id\traw_category\n3\n", "line 2: id"),
        ("id\traw_category\n3\ta\n99999999\tb\n", "line 3: id"),
    ],
)
def test_wrong_tables_are_named(text, message, tmp_path):
    path = tmp_path / "table.tsv"
    path.write_text(text)
    with malformed(message):
        read_label_table(path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::drsplat.errors.DrSplatWarning")
def test_damaged_files(scene, bounded_memory):
    segments, groups = (scene_file(scene, end) for end in (".segs.json", ".aggregation.json"))
    for path, read in (
        (scene_file(scene, "_vh_clean_2.labels.ply"), read_scannet_labels),
        (scene / "scannetv2-labels.combined.tsv", read_label_table),
        (groups, lambda path: read_scannet_instances(segments, path)),
        (segments, lambda path: read_scannet_instances(path, groups)),
    ):
        assert 0 < survivors(path, read, seeded(len(path.name)), MUTANTS) < MUTANTS


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_sets_are_whole(name):
    known = label_set(name)
    count = {"scannet19": 19, "scannet15": 15, "scannet10": 10, "scannet200": 200, "household": 13}
    assert len(known) == count[name]
    assert_array_equal(known.classes(np.array(known.ids)), np.arange(1, len(known) + 1))


def test_built_in_sets_nest_and_have_the_known_entries():
    large, middle, small = (label_set(f"scannet{n}") for n in (19, 15, 10))
    assert set(small.ids) < set(middle.ids) < set(large.ids)
    assert dict(zip(large.ids, large.names, strict=True))[28] == "showercurtain"
    of_200 = dict(zip(label_set("scannet200").ids, label_set("scannet200").names, strict=True))
    known = {1: "wall", 2: "chair", 11: "bed", 13: "pillow", 1191: "mattress"}
    assert {number: of_200[number] for number in known} == known


def test_ids_that_are_not_in_the_set_are_0():
    known = LabelSet("k", (5, 2), ("a", "b"), ("a", "b"))
    assert_array_equal(known.classes(np.array([0, 2, 5, 6, -1, 999])), [0, 2, 1, 0, 0, 0])
    assert known.prompted("a photo of a {}").prompts == ("a photo of a a", "a photo of a b")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 wall\n", "line 1"),
        ("1\twall\nx\tfloor\n", "line 2"),
        ("1\twall\n1\tfloor\n", "1 occurs twice"),
        ("1\twall\n2\twall\n", "'wall' occurs twice"),
        ("", "an id, a name"),
        ("0\twall\n", "ids must be"),
    ],
)
def test_sets_from_files(text, message, tmp_path):
    path = tmp_path / "mine.tsv"
    path.write_text("# mine\nid\tname\n3\tbed\tthe bed\n")
    assert label_set(str(path)).prompts == ("the bed",)
    path.write_text(text)
    with pytest.raises((FormatError, InputError), match=message):
        label_set(str(path))


def test_unknown_set_lists_the_known_ones():
    with refused("scannet19"):
        label_set("scannet21")
