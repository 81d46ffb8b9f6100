"""`drsplat edit`: what a stranger types, what it prints and writes."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from command_line import Capture, Line, answer_of, error_of
from drsplat import Query, open_scene, read_gaussians
from drsplat.authoring.editing import Duplicate, Edit, EditFile, EditList, Everything
from drsplat.authoring.editing.draft import Draft
from drsplat.field.labels import Label, LabelFile
from drsplat.formats.npy import write_npy
from drsplat.fronts.commands.edit_options import note_own_scenes
from toy_capture import PER_THING


@pytest.fixture
def edit(room: Path, capsys: Capture) -> Line:
    return Line(capsys, "edit", room / "scene.ply")


def red(room: Path) -> np.ndarray:
    """The rows that the query selects."""
    (match,) = open_scene(room / "room.field", scene=room / "scene.ply").locate(Query("red mug"))
    return match.gaussian_ids


def test_a_query_is_recoloured_and_undone(room, edit):
    scene, field = room / "scene.ply", room / "room.field"
    before, output = read_gaussians(scene), room / "edited.ply"
    words = ["--field", field, "--query", "red mug", "--recolour", "#2060ff"]
    answer = edit(*words)
    assert (answer["num_edits"], answer["num_undone"]) == (1, 0)
    assert answer["edits"] == [{"number": 1, "do": "recolour", "of": "“red mug”", "done": True}]
    edit("--field", field, "--save", output)
    after = read_gaussians(output)
    changed = np.flatnonzero((np.abs(after.sh - before.sh) > 1e-6).any(axis=(1, 2)))
    assert_array_equal(changed, red(room))
    assert sorted(np.unique(after.extra["object_id"])) == [0, 1]
    assert edit("--undo", "--save", room / "undone.ply")["num_undone"] == 1
    assert_array_equal(read_gaussians(room / "undone.ply").sh, before.sh)
    assert edit("--redo")["num_edits"] == 1
    assert scene.read_bytes() == (room.parent / "room" / "scene.ply").read_bytes()


def test_changes_are_done_in_the_order_given(room, edit):
    field = room / "room.field"
    answer = edit("--field", field, "--object", 0, "--scale", 2, "--move", -0.2, 0, 1, "--opacity", 0.5,
        "--duplicate", 0, 1, 0, "--turn", 30, "--axis", 0, 0, 1,
    )  # fmt: skip
    assert [edit["do"] for edit in answer["edits"]] == ["scale", "move", "opacity", "duplicate", "turn"]
    assert answer["num_gaussians"] == answer["num_gaussians_before"] + PER_THING
    answer = edit("--copies", 4, "--remove")
    assert answer["num_gaussians"] == answer["num_gaussians_before"]
    assert "what edit 4 added" in edit.text("--list")
    assert edit("--undo", 6)["num_edits"] == 0
    assert "no edit to undo" in edit.error("--undo")


def test_a_folder_is_enough_and_pictures_are_before_and_after(room, capsys):
    for name in ("images", "cameras.json"):
        source = room / "capture" / name
        if source.exists():
            shutil.move(source, room / name)
    picture = room / "out.png"
    answer = answer_of(capsys, "edit", room, "--query", "red mug", "--remove", "--picture", picture)
    assert answer["scene"] == str(room / "scene.ply")
    assert answer["view"]
    pixels = np.asarray(Image.open(picture), int)
    width = pixels.shape[1]
    half = pixels[:, : width // 2], pixels[:, -(width // 2) :]
    red_pixels = [int(((one[..., 0] > 150) & (one[..., 1] < 90)).sum()) for one in half]
    assert red_pixels[0] > 20
    assert red_pixels[1] < red_pixels[0] / 5


def test_labels_boxes_rows_and_photos(room, edit):
    scene, field = room / "scene.ply", room / "room.field"
    opened = open_scene(field, scene=scene)
    ids = opened.objects[1].gaussian_ids
    LabelFile.beside(field).add(Label.of("my plate", opened.field.scene, ids, np.zeros(3)))
    Image.new("RGB", (8, 8), (200, 180, 20)).save(room / "photo.png")
    write_npy(room / "ids.npy", np.array([0, 5], np.int64))
    base = edit.plus("--field", field)
    base("--label", "My Plate", "--palette", "#203040,gold")
    base("--label", "my plate", "--like-photo", room / "photo.png")
    base("--rows", room / "ids.npy", "--remove")
    answer = base("--box", -0.7, 0, 0, 1, 1, 1, "--isolate")
    assert [edit["of"] for edit in answer["edits"]] == [
        "“My Plate”", "“my plate”", "2 rows", "the box at -0.70 0.00 0.00",
    ]  # fmt: skip
    assert answer["num_gaussians"] == PER_THING - 2


def test_an_object_of_another_scene(room, edit):
    other = room.parent / "other"
    shutil.copytree(room, other)
    scene, field = room / "scene.ply", room / "room.field"
    given = ["--field", field, "--object", 0, "--replace", other, "--with-object", 1, "--up", "+z"]
    answer = edit(*given, "--save", room / "edited.ply", "--edits", "kept")
    assert answer["num_gaussians"] == answer["num_gaussians_before"]
    after = read_gaussians(room / "edited.ply")
    stands = after.subset(after.extra["object_id"] == 0).means
    goes = read_gaussians(scene).means[:PER_THING]
    assert_allclose(stands.mean(axis=0), goes.mean(axis=0), atol=0.05)
    stored = json.loads((room / "scene.edits.json").read_text())["edits"][0]
    assert stored["scene"] == "../other/scene.ply"


def test_annotations(room, edit):
    field = room / "room.field"
    edit("--field", field, "--query", "red mug", "--annotate", "from Delft")
    answer = edit("--at", 1, 2, 3, "--annotate", "here")
    assert [one["text"] for one in answer["annotations"]] == ["from Delft", "here"]
    assert_allclose(answer["annotations"][0]["center"], (-0.7, 0, 0), atol=0.1)
    assert answer["annotations"][1]["center"] == [1, 2, 3]
    assert "annotation 2: here" in edit.text()
    answer = edit("--drop-annotation", 1)
    assert [one["text"] for one in answer["annotations"]] == ["here"]


def test_a_scene_without_a_field_has_pictures_and_an_up_of_its_photos(room, edit):
    base = edit.plus("--box", -0.7, 0, 0, 1, 1, 1, "--turn", 30)
    assert "pass --up DIRECTION, e.g. --up +z, or --views CAPTURE" in base.error()
    assert "pass --views CAPTURE" in base.error("--up", "+z", "--picture", room / "out.png")
    answer = base("--views", room / "capture", "--picture", room / "out.png")
    assert answer["view"]
    stored = json.loads((room / "scene.edits.json").read_text())["edits"]
    assert_allclose(stored[0]["axis"], (0, 0, 1), atol=0.2)
    assert np.asarray(Image.open(room / "out.png")).shape[1] > 96


def test_an_annotation_is_where_its_thing_is_now(room, edit):
    base = edit.plus("--field", room / "room.field")
    words = ["--query", "red mug", "--move", 0, 0, 2, "--duplicate", 0, 1, 0]
    moved = base(*words, "--annotate", "up here")
    assert_allclose(moved["annotations"][0]["center"], (-0.7, 0, 2), atol=0.1)
    copied = base("--copies", 2, "--annotate", "its copy")
    assert_allclose(copied["annotations"][1]["center"], (-0.7, 1, 2), atol=0.1)


def test_a_field_does_not_fit_what_was_saved_and_says_what_does(room, capsys, edit):
    for more in ([], ["--duplicate", 0, 1, 0]):
        words = ["--field", room / "room.field", "--query", "red mug", "--move", 0, 0, 2, *more]
        edit(*words, "--save", room / "saved.ply", "--overwrite")
        said = error_of(capsys, "locate", room / "room.field", "red mug", "--scene", room / "saved.ply")
        assert "of a scene that was edited, the one that the edits lie beside" in said


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--remove"], "nothing to edit was named: pass --query WORDS"),
        (["--query", "red mug", "--remove"], "pass --field FIELD"),
        (["--everything", "--turn", 30], "pass --up DIRECTION"),
        (["--everything", "--turn", 1e30, "--axis", "z"], "up to 1,000,000 degrees either way, got 1e+30"),
        (["--box", 0, 0, 0, 0, 1, 1, "--remove"], "lengths above 0"),
        (["--everything", "--remove", "--undo"], "one of them at a time"),
        (["--everything", "--fill"], "edit 1: fill: no ground and no wall"),
        (["--undo"], "no edit to undo"),
        (["--everything", "--recolour", "bluish"], "expected a colour, e.g. #2060ff"),
        (["--at", 1, 2, 3], "--annotate"),
        (["--everything", "--replace", "none.ply", "--up", "+z"], "there is no such file"),
        (["--copies", 1, "--remove"], "edit 1 added nothing"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_said_and_leaves_nothing(room, given, said, edit):
    assert said in edit.error(*given)
    assert not (room / "scene.edits.json").exists()


def test_what_fails_keeps_no_part_of_it(room, edit):
    """An annotation and a change, changes and their file: the same command can be given again."""
    before = {path.name for path in room.iterdir()}
    base = edit.plus("--field", room / "room.field")
    note = ["--query", "red mug", "--annotate", "from Delft"]
    assert "edit 1: fill: no ground" in base.error(*note, "--fill")
    far = ["--move", 3e38, 0, 0]
    assert "beyond all numbers" in base.error(*note, *far, *far)
    assert "no annotation 3" in base.error(*note, "--move", 0, 0, 1, "--drop-annotation", 3)
    nowhere = ["--save", room / "nowhere" / "out.ply"]
    assert "no folder" in base.error(*note, "--remove", *nowhere)
    picture = ["--picture", room / "a.png", "--views", room / "capture", "--view", "x"]
    assert "no view 'x'" in base.error(*note, "--remove", *picture)
    assert {path.name for path in room.iterdir()} == before


def test_what_moves_is_not_edited_as_a_file(room, capsys):
    said = error_of(capsys, "edit", room / "frames", "--everything", "--remove")
    assert "this scene moves" in said
    assert "edit a PLY of one time" in said


@pytest.mark.parametrize(
    "given",
    [
        ["--move", 1, 2],
        ["--object", 1, "--everything"],
        ["--everything", "--turn", 3, "--axis", "w"],
        ["--everything", "--turn", 3, "--axis", 0, "w", 1],
        ["--everything", "--turn", 3, "--axis", 0, 1],
    ],
)
def test_what_is_misspelt_is_misuse(given, edit):
    edit.error(*given, code=2)


def test_what_was_saved_of_a_scene_does_not_take_its_place(room, capsys):
    """The rows are in the same places, and its name comes first."""
    recolour = ["--query", "red mug", "--recolour", "#2060ff"]
    assert answer_of(capsys, "edit", room, *recolour, "--save", room / "answer.ply")["kept"] is False
    listed = answer_of(capsys, "edit", room, "--list")
    assert (listed["scene"], listed["num_edits"]) == (str(room / "scene.ply"), 0)
    assert answer_of(capsys, "edit", room, *recolour)["scene"] == str(room / "scene.ply")
    assert answer_of(capsys, "edit", room, "--undo")["num_undone"] == 1


APPLIED = "drsplat: 1 kept edit applied (--edits none to leave them out)\n"
LEFT_OUT = "drsplat: 1 kept edit left out (--edits kept to apply them)\n"


def test_a_change_that_is_saved_is_done_alone_and_kept_edits_are_told(room, edit):
    scene, ball = room / "scene.ply", ["--box", -0.7, 0, 0, 1, 1, 1]
    count = len(read_gaussians(scene))
    assert edit.notes(*ball, "--remove", "--save", room / "alone.ply") == ""
    assert not (room / "scene.edits.json").exists()
    assert len(read_gaussians(room / "alone.ply")) == count - PER_THING
    assert edit.notes(*ball, "--remove") == ""
    kept = (room / "scene.edits.json").read_bytes()
    twice = edit.plus("--everything", "--duplicate", 0, 0, 3, "--save")
    for output, more, said, rows in (
        ("changed.ply", [], LEFT_OUT, 2 * count),
        ("none.ply", ["--edits", "none"], LEFT_OUT, 2 * count),
    ):
        assert twice.notes(room / output, *more) == said
        assert len(read_gaussians(room / output)) == rows
        assert (room / "scene.edits.json").read_bytes() == kept
    assert edit.notes("--save", room / "whole.ply") == APPLIED
    assert len(read_gaussians(room / "whole.ply")) == count - PER_THING
    assert edit.notes("--save", room / "own.ply", "--edits", "none") == LEFT_OUT
    assert len(read_gaussians(room / "own.ply")) == count
    assert twice.notes(room / "both.ply", "--edits", "kept") == APPLIED
    assert len(read_gaussians(room / "both.ply")) == 2 * (count - PER_THING)
    assert edit("--list")["num_edits"] == 2


def test_what_is_printed_says_where_edits_are(room, edit):
    scene, ball = room / "scene.ply", ["--box", -0.7, 0, 0, 1, 1, 1]
    kept = edit.text(*ball, "--remove")
    assert f"1 edit kept beside {scene}, 0 undone" in kept
    assert f"drsplat edit {scene} --save OUT.ply applies the kept edits" in kept
    saved = edit.text(*ball, "--remove", "--save", room / "out.ply")
    assert saved.startswith("1 edit of this call\n")
    assert "kept" not in saved
    own = edit.text("--save", room / "own.ply", "--edits", "none")
    assert own.startswith("0 edits of this call\n")
    assert " edit " not in own  # no table without rows


def test_a_picture_shows_the_kept_edits_and_says_so(room, edit):
    base = edit.plus("--views", room / "capture", "--box", -0.7, 0, 0, 1, 1, 1)
    base.notes("--remove")
    assert base.notes("--opacity", 0.5, "--picture", room / "a.png") == APPLIED


def test_annotations_stay_where_the_kept_edits_put_things(room, edit):
    base = edit.plus("--field", room / "room.field", "--query", "red mug")
    base("--move", 0, 0, 2)
    answer = base("--move", 0, 5, 0, "--save", room / "a.ply", "--annotate", "up here")
    assert_allclose(answer["annotations"][0]["center"], (-0.7, 0, 2), atol=0.1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--everything", "--remove", "--edits", "none"], "pass --save OUT.ply"),
        (["--undo", "--edits", "none"], "drop --edits none"),
        (["--copies", 1, "--remove", "--save", "out.ply"], "add --edits kept"),
    ],
)
def test_what_would_go_nowhere_is_refused(room, monkeypatch, capsys, given, said):
    monkeypatch.chdir(room)
    assert said in error_of(capsys, "edit", "scene.ply", *given)
    assert not (room / "scene.edits.json").exists()


@pytest.mark.slow
def test_a_page_and_a_rendering_say_which_edits_are_in_them(room, capsys, edit):
    scene, field = room / "scene.ply", room / "room.field"
    edit("--box", -0.7, 0, 0, 1, 1, 1, "--remove")
    page = Line(capsys, "view", field, "--scene", scene, "--ask", "blue plate", "--export")
    assert page.notes(room / "edited.html") == APPLIED
    assert page.notes(room / "none.html", "--edits", "none") == ""
    assert page(room / "a.html", "--edits", "kept")["num_edits"] == 1
    seen = ("--views", room / "capture", "--view", "photo_0", "--overwrite", "-o")
    drawn = Line(capsys, "render", scene, *seen)
    assert drawn.notes(room / "own", "--edits", "none") == LEFT_OUT
    assert drawn.notes(room / "shown") == APPLIED
    assert edit.notes("--save", room / "saved.ply") == APPLIED
    assert Line(capsys, "render", room / "saved.ply", *seen).notes(room / "saved") == ""
    (room / "scene.edits.json").unlink()
    assert page.notes(room / "bare.html") == ""
    pages = [(room / f"{name}.html").read_bytes() for name in ("edited", "none", "bare")]
    assert pages[1] == pages[2] != pages[0]
    assert drawn.notes(room / "bare") == ""
    own, shown, saved, bare = ((room / name / "photo_0.png").read_bytes() for name in ("own", "shown", "saved", "bare"))
    assert own == bare != shown == saved


@pytest.mark.slow
def test_an_answer_is_drawn_where_edits_have_put_it(room, capsys, edit):
    scene, field = room / "scene.ply", room / "room.field"
    seen = ("--views", room / "capture", "--view", "photo_0")
    drawn = Line(capsys, "render", scene, *seen, "--field", field, "--query", "red mug", "-o")
    where = edit.plus("--field", field, "--query", "red mug")
    assert drawn(room / "before")["num_matches"] == 1
    where("--move", 0, 0, 0.4)
    moved = drawn(room / "moved", "--boxes")
    assert (moved["num_matches"], moved["num_selected"]) == (1, PER_THING)
    where("--duplicate", 0, 0, 0.4)
    assert drawn(room / "twice")["num_selected"] == PER_THING
    where("--remove")
    gone = drawn(room / "gone")
    assert (gone["num_matches"], gone["num_selected"]) == (0, 0)
    assert drawn(room / "own", "--edits", "none")["num_matches"] == 1
    pictures = [(room / name / "photo_0.png").read_bytes() for name in ("before", "moved", "gone", "own")]
    assert pictures[0] == pictures[3]
    assert len(set(pictures)) == 3


@pytest.mark.parametrize(
    ("given", "stored"), [(["x"], [1, 0, 0]), (["+z"], [0, 0, 1]), (["=-y"], [0, -1, 0]), ([0, "-1", 2], [0, -1, 2])]
)
def test_an_axis_is_a_letter_or_three_numbers(room, given, stored, edit):
    axis = [f"--axis{given[0]}"] if str(given[0]).startswith("=") else ["--axis", *given]
    edit("--everything", "--turn", 30, *axis)
    assert json.loads((room / "scene.edits.json").read_text())["edits"][0]["axis"] == stored


def test_a_list_is_printed_and_undone_without_being_applied(room, monkeypatch, edit):
    """A stranger's list may ask for more than there is memory."""
    scene = room / "scene.ply"
    gaussians = read_gaussians(scene)
    doubled = Edit(Everything(), Duplicate((1.0, 0.0, 0.0)))
    EditFile.beside(scene).change(gaussians, lambda _: EditList(gaussians.fingerprint, (doubled,) * 20, 20))
    said = edit.error("--save", room / "out.ply")
    assert "edit 12: adds 614,400 Gaussians to 614,400, and edits of this scene make up to 1,000,000" in said
    monkeypatch.setattr(Draft, "of", lambda _: pytest.fail("applied"))
    assert edit("--list")["num_gaussians"] is None
    assert edit("--undo", 20)["num_undone"] == 20


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["locate", "select", "segment", "objects", "photograph"])
def test_what_is_saved_of_a_scene_with_kept_edits_says_that_they_are_left_out(verb, room, capsys, edit):
    scene, field = room / "scene.ply", room / "room.field"
    edit("--field", field, "--object", 0, "--remove")
    more = {"segment": ["--classes", "red mug,blue plate"], "objects": []}.get(verb, ["red mug"])
    command = [verb, field, *more, "--scene", scene, "--save", room / "out.ply"]
    if verb == "photograph":
        command = [verb, scene, "--number", 4, "--size", "64x48", "--output", room / "renderings"]
    said = Line(capsys, *command).notes()
    assert "1 kept edit left out (`drsplat edit SCENE --save OUT.ply` writes the scene with them)" in said
    if verb != "photograph":
        assert len(read_gaussians(room / "out.ply")) == 2 * PER_THING  # and they are


def test_a_service_names_the_scenes_whose_kept_edits_its_answers_lack(room, capsys, edit):
    (room / "broken").mkdir()
    (room / "broken" / "x.field").mkdir()
    note_own_scenes([room, room / "broken"])
    assert capsys.readouterr().err == ""
    edit("--everything", "--opacity", 0.5)
    note_own_scenes([room, room / "broken"])
    assert capsys.readouterr().err == (
        "drsplat: kept edits of 1 scene left out (`drsplat edit SCENE --save OUT.ply` writes the scene with them): "
        f"{room.name}\n"
    )
    edit("--undo")
    note_own_scenes([room])
    assert capsys.readouterr().err == ""


def test_inspect_counts_the_kept_edits(room, capsys, edit):
    assert answer_of(capsys, "inspect", room / "scene.ply")["num_kept_edits"] == 0
    edit("--everything", "--opacity", 0.5)
    assert [answer_of(capsys, "inspect", path)["num_kept_edits"] for path in (room / "scene.ply", room)] == [1, 1]
