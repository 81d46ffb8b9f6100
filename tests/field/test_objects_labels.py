"""Names that people gave: kept beside the field, matched by overlap, never lost, never believed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from command_line import answer_of, text_of
from drsplat import Scene, open_scene
from drsplat.errors import FormatError
from drsplat.field import LanguageField
from drsplat.field.labels import Label, LabelFile, matched
from drsplat.formats import json_files
from drsplat.formats.json_files import ids_of, spans_of_runs
from drsplat.formats.replacing import claimed_output
from known_objects import EACH, with_objects
from mutations import quota, seeded, survivors
from refusing import malformed, refused

MUTANTS = quota(3000)
ORIGIN = np.zeros(3)
THINGS, GROUP = (2, 3, 4), 5


@pytest.fixture(scope="module")
def field() -> LanguageField:
    return with_objects()[0]


@pytest.fixture
def labels(tmp_path) -> LabelFile:
    return LabelFile.beside(tmp_path / "a.field")


def label_of(field: LanguageField, name: str, ids: np.ndarray) -> Label:
    return Label.of(name, field.scene, ids, ORIGIN)


def test_the_file_lies_beside_the_field(tmp_path):
    assert LabelFile.beside(tmp_path / "room.field").path == tmp_path / "room.labels.json"
    assert LabelFile.beside(tmp_path / "room.v2").path == tmp_path / "room.v2.labels.json"
    assert LabelFile.beside(tmp_path / "none.field").read() == ()


@pytest.mark.slow
@given(st.sets(st.integers(0, 3 * EACH - 1), min_size=1))
def test_rows_survive_the_file(rows):
    field = with_objects()[0]
    ids = np.array(sorted(rows))
    label = label_of(field, "mug", ids)
    assert len(label) == len(ids)
    assert_array_equal(label.gaussian_ids(field), ids)


def test_millions_of_lengths_are_not_looked_at_each_in_turn(monkeypatch):
    """Three thousand labels of 4,800 lengths took 40 seconds."""
    mixed = spans_of_runs([0, 1.0, 2, 3], "here")
    monkeypatch.setattr(json_files, "as_count", None)
    assert_array_equal(spans_of_runs([0, 1, 2, 3], "here"), mixed)
    assert_array_equal(ids_of(mixed), [0, 3, 4, 5])
    assert len(ids_of(spans_of_runs([], "here"))) == 0


def test_what_is_written_is_read(labels, field):
    given = Label.of(" größe 🥤 ", field.scene, np.array([3, 4, 5, 9, 700]), np.array([1.0, -2, 0.5]))
    labels.add(given)
    (read,) = labels.read()
    assert (read.name, read.scene) == ("größe 🥤", field.scene)
    assert_array_equal(read.spans, [[3, 6], [9, 10], [700, 701]])
    assert_array_equal(read.center, [1, -2, 0.5])
    assert json.loads(labels.path.read_text())["labels"][0]["runs"] == [3, 3, 3, 1, 690, 1]
    assert read.means("GRÖSSE 🥤")
    assert not read.means("mug")


def test_the_best_overlap_wins(field):
    objects = field.objects
    third = field.gaussian_ids[objects.rows(THINGS[2])].astype(np.int64)
    found = matched(
        [
            label_of(field, "half of it", np.arange(EACH)[: EACH // 2]),  # the part is exactly this
            label_of(field, "most of it", np.arange(EACH)[50:]),
            label_of(field, "both", np.arange(2 * EACH)),
            label_of(field, "third", third[: len(third) * 6 // 10]),
            label_of(field, "too little", third[: len(third) * 4 // 10]),
        ],
        field,
    )
    assert {node: label.name for node, label in found.by_node.items()} == {
        0: "half of it", THINGS[0]: "most of it", GROUP: "both", THINGS[2]: "third",
    }  # fmt: skip
    assert [label.name for label in found.orphans] == ["too little"]


def test_of_two_labels_of_one_thing_the_better_one_counts(field):
    every = np.arange(EACH, 2 * EACH)
    found = matched([label_of(field, "nearly", every[20:]), label_of(field, "exactly", every)], field)
    assert found.by_node[THINGS[1]].name == "exactly"
    assert [label.name for label in found.orphans] == ["nearly"]


def test_gaussians_without_a_feature_count_as_well(field):
    """The last ten of the scene have none: a label that has them overlaps less."""
    rows = np.arange(3 * EACH)[-20:]
    objects = field.objects
    assert objects is not None
    node_of = np.full(len(field), -1, np.int32)
    node_of[-10:] = THINGS[2]
    few = field.with_objects(replace(objects, node_of=node_of))
    assert matched([label_of(few, "ten of twenty", rows)], few).by_node[THINGS[2]].name == "ten of twenty"
    assert matched([label_of(few, "ten of 21", np.arange(3 * EACH)[-21:])], few).orphans


def test_labels_of_another_scene_are_kept_and_told(tmp_path, labels, field):
    field.save(tmp_path / "a.field")
    labels.add(Label.of("mug", "1500-0123", np.arange(EACH), ORIGIN))
    scene = open_scene(tmp_path / "a.field")
    assert scene.labels.by_node == {}
    assert [label.name for label in scene.labels.orphans] == ["mug"]
    scene.label(THINGS[0], "cup")
    assert [label.name for label in labels.read()] == ["mug", "cup"]


def test_a_correction_takes_the_place_of_the_name(tmp_path, field):
    field.save(tmp_path / "a.field")
    scene = open_scene(tmp_path / "a.field")
    scene.label(THINGS[0], "cup")
    scene.label(THINGS[1], "mug")
    scene.label(THINGS[0], "bowl")
    assert [match.label for match in scene.objects] == ["bowl", "mug", None]
    assert [match.label for match in open_scene(tmp_path / "a.field").objects] == ["bowl", "mug", None]
    assert [label.name for label in LabelFile.beside(tmp_path / "a.field").read()] == ["mug", "bowl"]


def test_names_outlive_the_field(tmp_path, field, capsys):
    """Made anew with other numbers, and half a percent of the Gaussians elsewhere."""
    field.save(tmp_path / "a.field")
    answer_of(capsys, "objects", tmp_path / "a.field", "--label", "mug", "--id", 0)
    objects = field.objects
    masses = objects.masses.copy()
    masses[THINGS[0]] = 1
    node_of = objects.node_of.copy()
    node_of[:3] = -1
    field.with_objects(replace(objects, masses=masses, node_of=node_of)).save(tmp_path / "a.field", overwrite=True)
    told = answer_of(capsys, "objects", tmp_path / "a.field")
    assert [one["label"] for one in told["objects"]] == [None, None, "mug"]
    field.with_objects(replace(objects, node_of=np.full(len(field), GROUP, np.int32))).save(
        tmp_path / "a.field", overwrite=True
    )
    assert answer_of(capsys, "objects", tmp_path / "a.field")["labels_of_none"] == ["mug"]
    assert "the label 'mug' names nothing" in text_of(capsys, "objects", tmp_path / "a.field")


def test_a_scene_in_memory_has_nowhere_to_keep_names(field):
    with refused("nowhere to keep a name"):
        Scene(field).label(THINGS[0], "mug")


@pytest.mark.parametrize("name", ["", "  ", "x" * 201, "half \ud800"])
def test_names_that_are_none(name, tmp_path, field):
    field.save(tmp_path / "a.field")
    with refused("expected a text"):
        open_scene(tmp_path / "a.field").label(THINGS[0], name)
    assert not LabelFile.beside(tmp_path / "a.field").path.exists()


def test_one_writer_at_a_time(labels, field):
    with claimed_output(labels.path), refused("is being written by"):
        labels.add(label_of(field, "mug", np.arange(5)))
    labels.add(label_of(field, "mug", np.arange(5)))
    assert [path.name for path in labels.path.parent.iterdir()] == ["a.labels.json"]


LABEL = {"name": "a", "scene": "b", "center": [0, 0, 0], "runs": [0, 1]}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "labels"}, "expected 'drsplat labels'"),
        ({"version": 2}, "expected 'drsplat labels' of version 1, got 2"),
        ({"labels": {}}, "labels: expected a list"),
        ({"labels": [LABEL] * 10_001}, "up to 10,000 labels"),
        ({"labels": [[]]}, "labels: 0: expected an object with name, scene"),
        ({"name": 3}, "name: expected a text"),
        ({"name": " "}, "expected a text"),
        ({"runs": [1]}, "pairs of lengths"),
        ({"runs": []}, "one or more"),
        ({"runs": [0, 0]}, "ascending rows"),
        ({"runs": [-1, 2]}, "pairs of lengths"),
        ({"runs": [0, 1e12]}, "pairs of lengths"),
        ({"runs": [0, 1.5]}, "whole number"),
        ({"runs": [0, True]}, "expected a number"),
        ({"runs": [0, 10**400]}, "pairs of lengths"),
        ({"runs": [0, 2, 0, 2]}, "ascending rows"),
        ({"center": [0, 1]}, "3 numbers"),
        ({"center": [0, 1, "x"]}, "number"),
    ],
)
def test_files_that_cannot_be(change, said, labels, field):
    labels.add(label_of(field, "mug", np.arange(5)))
    document = json.loads(labels.path.read_text())
    (document if change.keys() <= document.keys() else document["labels"][0]).update(change)
    labels.path.write_text(json.dumps(document))
    with malformed(said):
        labels.read()
    with pytest.raises(FormatError):
        labels.add(label_of(field, "cup", np.arange(9)))
    assert json.loads(labels.path.read_text()) == document  # nothing that cannot be read is written over


@pytest.mark.slow
def test_damaged_labels(labels, field, bounded_memory):
    labels.add(label_of(field, "mug", np.arange(EACH)))
    labels.add(Label.of("of another", "2000000000-00", np.array([1, 5, 7]), ORIGIN))

    def read(_):
        for label in (*matched(labels.read(), field).by_node.values(), *labels.read()):
            assert label.gaussian_ids(field).max(initial=-1) < field.num_gaussians

    assert 0 < survivors(labels.path, read, seeded(7), MUTANTS) < MUTANTS
