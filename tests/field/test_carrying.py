"""Fields whose scene was compressed: the same features at Gaussians that have moved a little, in another order."""

import shutil
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from command_line import answer_of, error_of
from drsplat.cli import main
from drsplat.errors import MismatchError
from drsplat.field import Assignment, LanguageField, assign, carry_field, carry_label
from drsplat.field.carrying import MAX_LOST_SHARE
from drsplat.field.labels import Label, LabelFile
from drsplat.formats.known import parse_gaussians
from growing_fields import Killed, files_of, killed_at
from known_objects import with_objects
from refusing import refused
from scene_files import spz_bytes
from scenes import random_gaussians


@pytest.fixture(scope="module")
def known() -> tuple[LanguageField, ds.Gaussians]:
    return with_objects(threads=1)


def shuffled(gaussians: ds.Gaussians, seed: int = 0) -> tuple[ds.Gaussians, np.ndarray]:
    """Rows in another order, and the new row of each."""
    order = default_rng(seed).permutation(len(gaussians))
    return gaussians.subset(order), np.argsort(order)


def compressed(gaussians: ds.Gaussians) -> tuple[ds.Gaussians, np.ndarray]:
    """As SPZ, in another order, and the new row of each."""
    rows, places = shuffled(gaussians)
    return parse_gaussians(memoryview(spz_of(rows))), places


def spz_of(gaussians: ds.Gaussians) -> bytes:
    """In the axes of SPZ: y up, z back. Rotations stay; nothing looks at them."""
    return spz_bytes(replace(gaussians, means=gaussians.means * np.float32([1, -1, -1])), 3)


def test_a_compressed_scene_has_each_gaussian_once(known):
    """SPZ keeps 1/4096 of a unit, so a place may be off by half of that on each axis."""
    _, scene = known
    small, places = compressed(scene)
    assert small.fingerprint != scene.fingerprint
    found = assign(scene, small, threads=1)
    assert_array_equal(found.rows, places)
    assert 0 < found.distances.max() <= np.sqrt(3) / 8192 * 1.001 < found.reach


def test_everything_goes_along(known):
    field, scene = known
    small, places = compressed(scene)
    carried = carry_field(field, assign(scene, small, threads=1))
    carried.check_scene(small)
    rows = carried.rows_of(places[field.gaussian_ids])
    assert_array_equal(np.sort(rows), np.arange(len(field)))
    assert_array_equal(carried.feature(rows), field.feature(np.arange(len(field))))
    assert_array_equal(carried.evidence.weights[rows].toarray(), field.evidence.weights.toarray())
    assert_array_equal(carried.objects.node_of[rows], field.objects.node_of)
    assert_array_equal(carried.objects.centers, field.objects.centers)
    query = np.eye(8, dtype=np.float32)[1]
    assert_array_equal(carried.scores(query)[rows], field.scores(query))
    back = carry_field(carried, assign(small, scene, threads=1))
    assert back.equals(field)


def test_a_field_that_was_registered_can_be_carried_and_goes_on_growing(tmp_path):
    from drsplat.field.growing import remove_views
    from toy_capture import write_toy_capture

    folder = write_toy_capture(tmp_path)
    scene = ds.read_gaussians(folder / "scene.ply")
    capture = folder / "capture"
    views, features = ds.read_views(capture), ds.read_features(capture / "language_features")
    field = ds.register(scene, views, features, threads=1).to_field()
    small, _ = compressed(scene)
    assignment = assign(scene, small, threads=1)
    name = views[0].name
    first = remove_views(carry_field(field, assignment), small, [name], threads=1).field
    then = carry_field(remove_views(field, scene, [name], threads=1).field, assignment)
    assert_array_equal(first.gaussian_ids, then.gaussian_ids)
    assert_array_equal(first.evidence.weights.toarray(), then.evidence.weights.toarray())


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-4, 0.05, 1.0]))
def test_no_row_is_given_twice_and_none_from_out_of_reach(seed, noise):
    rng = default_rng(seed)
    scene = random_gaussians(60, seed)
    scene = replace(scene, means=scene.means[rng.integers(0, 60, 60)])  # some in one place
    moved = scene.means + noise * rng.standard_normal((60, 3)).astype(np.float32)
    found = assign(scene, replace(scene, means=moved), threads=1)
    rows = found.rows[found.rows >= 0]
    assert len(np.unique(rows)) == len(rows)
    assert (found.distances[found.rows >= 0] <= found.reach).all()
    if noise == 0:
        assert_array_equal(found.rows, np.arange(60))


def test_places_far_from_zero_are_compared_exactly(known):
    _, scene = known
    far = replace(scene, origin=np.array([5e5, 5.4e6, 100.0]))
    rows, places = shuffled(far)
    assert_array_equal(assign(far, rows, threads=1).rows, places)


def test_another_scene_is_refused_with_numbers_and_cure(known):
    field, scene = known
    rng = default_rng(0)
    other = replace(scene, means=scene.means + rng.normal(0, 0.3, scene.means.shape).astype(np.float32))
    with pytest.raises(MismatchError, match=r"of 1,490 Gaussians with a feature .* within .* register the new one"):
        carry_field(field, assign(scene, other, threads=1))
    with refused("assignment of 400"):
        carry_field(field, assign(random_gaussians(400), random_gaussians(400), threads=1))
    with refused("expected two scenes with Gaussians"):
        assign(scene, scene.subset(np.arange(0)))


def test_a_few_that_are_gone_lose_their_feature_and_no_more(known):
    field, scene = known
    few = int(MAX_LOST_SHARE * len(field))
    carried = carry_field(field, assign(scene, scene.subset(np.arange(few, len(scene))), threads=1))
    assert len(carried) == len(field) - few
    assert_allclose(carried.gaussian_ids, field.gaussian_ids[few:] - few)
    with pytest.raises(MismatchError, match="at most 1% may"):
        carry_field(field, assign(scene, scene.subset(np.arange(few + 1, len(scene))), threads=1))


def test_names_go_along():
    rows = np.array([5, 4, -1, 0, 1, 2])
    assignment = Assignment(rows, np.zeros(6), 1.0, "6-new", 6)
    label = Label.of("mug", "6-old", np.array([0, 1, 2, 4]), np.zeros(3))
    carried = carry_label(label, assignment)
    assert (carried.name, carried.scene, carried.spans.tolist()) == ("mug", "6-new", [[1, 2], [4, 6]])
    assert carry_label(Label.of("mug", "6-old", np.array([2]), np.zeros(3)), assignment) is None
    beyond = Label("mug", "6-old", np.array([[3, 5], [6, 1 << 62]]), np.zeros(3))  # spans of a damaged file
    carried = carry_label(beyond, assignment)
    assert carried.spans.tolist() == [[0, 2]]


def test_names_that_cannot_be_read_leave_no_field_behind(known, tmp_path, capsys):
    field, scene = known
    ds.write_gaussians(tmp_path / "scene.ply", scene)
    field.save(tmp_path / "old.field")
    (tmp_path / "old.labels.json").write_text("{")
    old, scene_file = str(tmp_path / "old.field"), str(tmp_path / "scene.ply")
    assert "old.labels.json" in error_of(
        capsys, "field", "carry", old, scene_file, "--scene", scene_file, "-o", tmp_path / "new.field"
    )
    assert not (tmp_path / "new.field").exists()


def test_the_command_does_what_the_refusal_says(known, tmp_path, capsys):
    field, scene = known
    small, places = compressed(scene)
    ds.write_gaussians(tmp_path / "scene.ply", scene)
    (tmp_path / "scene.spz").write_bytes(spz_of(shuffled(scene)[0]))
    field.save(tmp_path / "old.field")
    LabelFile.beside(tmp_path / "old.field").add(Label.of("mug", field.scene, np.arange(500), np.zeros(3)))
    old, new, there = (str(tmp_path / name) for name in ("old.field", "scene.spz", "new.field"))
    assert "drsplat field carry FIELD NEW_SCENE --scene OLD_SCENE --output NEW_FIELD" in error_of(
        capsys, "objects", old, "--scene", new, "--save", tmp_path / "ids.npy"
    )
    answer = answer_of(capsys, "field", "carry", old, new, "--scene", tmp_path / "scene.ply", "-o", there)
    assert (answer["num_registered"], answer["num_lost"], answer["labels"]) == (len(field), 0, ["mug"])
    carried = ds.load_field(there)
    carried.check_scene(small)
    (label,) = LabelFile.beside(there).read()
    assert_array_equal(label.gaussian_ids(carried), np.sort(places[:500]))
    assert main(["objects", there, "--scene", new, "--save", str(tmp_path / "ids.npy")]) == 0
    assert main(["field", "carry", old, new, "--scene", new, "-o", str(tmp_path / "x.field")]) == 1


@pytest.fixture
def named(known, tmp_path) -> list[str]:
    """Write a field with two objects of one name and its scene in another order; return the command."""
    field, scene = known
    ds.write_gaussians(tmp_path / "scene.ply", scene)
    ds.write_gaussians(tmp_path / "new.ply", shuffled(scene)[0])
    field.save(tmp_path / "old.field")
    for rows in (np.arange(500), np.arange(500, 900)):
        LabelFile.beside(tmp_path / "old.field").add(Label.of("mug", field.scene, rows, np.zeros(3)))
    old, new, before = (str(tmp_path / name) for name in ("old.field", "new.ply", "scene.ply"))
    return ["field", "carry", old, new, "--scene", before, "--output"]


def test_two_objects_of_one_name_keep_it(named, tmp_path):
    there = tmp_path / "new.field"
    assert main([*named, str(there)]) == 0
    assert [(label.name, len(label)) for label in LabelFile.beside(there).read()] == [("mug", 500), ("mug", 400)]
    assert main([*named, str(there), "--overwrite"]) == 0
    assert len(LabelFile.beside(there).read()) == 2


@pytest.mark.slow
def test_a_killed_carry_has_the_names_once_it_has_the_field(named, tmp_path, monkeypatch):
    whole, there = tmp_path / "whole" / "new.field", tmp_path / "new" / "new.field"
    whole.parent.mkdir()
    with killed_at(1 << 30, monkeypatch.context) as changes:
        assert main([*named, str(whole)]) == 0
    assert {"replace", "rename"} <= set(changes)
    for step in range(len(changes)):
        shutil.rmtree(there.parent, ignore_errors=True)
        there.parent.mkdir()
        with killed_at(step, monkeypatch.context), suppress(Killed):
            main([*named, str(there)])
        if not there.exists():
            assert main([*named, str(there)]) == 0
        assert files_of(there) == files_of(whole)
        labels, expected = (folder.with_name("new.labels.json") for folder in (there, whole))
        assert labels.read_bytes() == expected.read_bytes()
