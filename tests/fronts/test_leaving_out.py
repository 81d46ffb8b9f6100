"""--without: photos that are kept for measuring."""

from dataclasses import replace
from pathlib import Path

import pytest

import drsplat as ds
from command_line import answer_of, error_of
from drsplat.fronts.commands.options import left_out
from refusing import refused
from toy_capture import write_toy_capture

NAMES = [f"room/photo_{n:02}.png" for n in range(10)]


def test_every_nth_is_that_of_training():
    assert left_out(NAMES[::-1], "every:4") == {NAMES[0], NAMES[4], NAMES[8]}
    assert left_out(NAMES, None) == set()


def test_names_are_taken_with_and_without_suffix(tmp_path):
    file = tmp_path / "labelled.txt"
    file.write_text("room/photo_03\n\nroom/photo_07.png\n")
    assert left_out(NAMES, str(file)) == {NAMES[3], NAMES[7]}


@pytest.mark.parametrize(
    ("content", "said"),
    [("room/photo_99\nroom/photo_01", "no photo has these names: room/photo_99"), ("", "leaves out 0 of 10")],
)  # fmt: skip
def test_unknown_names_are_errors(content, said, tmp_path):
    file = tmp_path / "labelled.txt"
    file.write_text(content)
    with refused(said):
        left_out(NAMES, str(file))


@pytest.mark.parametrize("step", ["0", "1", "-3", "x", "", "9" * 50])
def test_a_step_that_leaves_nothing_is_an_error(step):
    with refused("whole number from 2"):
        left_out(NAMES, f"every:{step}")


def test_the_field_knows_which_photos_it_is_made_from(tmp_path, capsys):
    room = write_toy_capture(tmp_path)
    capture, output = room / "capture", room / "a.field"
    register = ["register", room / "scene.ply", capture, "--features", capture / "language_features"]
    parts = ["--parts", room / "parts", "--output", output]
    answer_of(capsys, *register, *parts)
    answer = answer_of(capsys, *register, *parts, "--without", "every:2", "--overwrite")
    assert answer["left_out"] == ["photo_0.png", "photo_2.png"]
    assert (answer["num_views"], answer["num_views_reused"]) == (2, 2)
    field = ds.load_field(output)
    assert field.evidence.masks.view_names == ("photo_1.png", "photo_3.png")
    assert field.left_out == ("photo_0.png", "photo_2.png")
    assert answer_of(capsys, "inspect", output)["left_out"] == ["photo_0.png", "photo_2.png"]
    again = ds.Registration.from_field(field)
    assert again.to_field(ds.Mixture()).left_out == field.left_out
    models = ["--segmenter", "graph", "--encoder", "drsplat-mini", "--output", room / "made"]
    answer = answer_of(capsys, "embed", capture, *models, "--without", "every:3")
    assert (answer["num_photos"], answer["left_out"]) == (2, ["photo_0.png", "photo_3.png"])
    assert sorted(ds.read_features(room / "made")) == ["photo_1", "photo_2"]
    assert "no photo has" in error_of(capsys, *register, "-o", room / "b.field", "--without", _names(room))


@pytest.mark.slow
def test_fields_with_other_photos_left_out_are_told_apart(tmp_path, capsys):
    """Even where the photo shows nothing of the scene, so that all features are the same."""
    room = write_toy_capture(tmp_path)
    argv = ["register", room / "scene.ply", room / "capture", "--features", room / "capture/language_features"]
    for name, without in (("a", []), ("b", ["--without", _names(room, "photo_1")])):
        answer_of(capsys, *argv, "--output", room / f"{name}.field", *without)
    a, b = (ds.load_field(room / f"{name}.field") for name in "ab")
    assert (a.left_out, b.left_out) == ((), ("photo_1.png",))
    bare = replace(b, left_out=())
    assert bare.fingerprint == b.fingerprint  # the memory is no part of what answers
    assert not bare.equals(b)
    assert a.equals(ds.load_field(room / "a.field"))
    (room / "b.field.parts").mkdir()  # of a run that was killed: it is not taken for another one
    assert "exists already" in error_of(capsys, *argv, "--output", room / "b.field")
    assert ds.load_field(room / "b.field").equals(b)


def test_photos_left_out_of_one_shard_and_registered_in_the_other_are_in(tmp_path):
    room = write_toy_capture(tmp_path)
    gaussians, views = ds.read_gaussians(room / "scene.ply"), ds.read_views(room / "capture")
    features = ds.read_features(room / "capture/language_features")
    halves = [ds.register(gaussians, half, features) for half in (views[:2], views[2:])]
    names = [view.name for view in views]
    one = replace(halves[0], left_out=(names[2], "x.png"))
    assert one.merged(replace(halves[1], left_out=("a.png",))).left_out == ("a.png", "x.png")


def _names(room: Path, name: str = "photo_9") -> Path:
    file = room / "names.txt"
    file.write_text(f"{name}\n")
    return file


def test_only_photos_can_be_left_out_of_an_evaluation(tmp_path, capsys):
    argv = ["evaluate", "voxel", tmp_path, "--scene", "s", "--field", "f", "--report", tmp_path / "r"]
    assert "--without is for lerf-ovs" in error_of(capsys, *argv, "--without", "every:2")
