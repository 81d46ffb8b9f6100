"""`drsplat export`: what is in the file for whatever is asked, read by the specifications alone."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from command_line import Capture, answer_of, error_of, text_of
from drsplat import Scene, open_scene, read_gaussians, write_gaussians
from drsplat.authoring.editing import Duplicate, Edit, EditFile, Move, Remove, Rows
from drsplat.authoring.editing.resolving import object_rows
from drsplat.authoring.exporting import export, labelled
from drsplat.authoring.exporting.placing import only_used
from drsplat.cli import main
from drsplat.errors import InputError
from drsplat.formats.annotations import AnnotationFile
from drsplat.formats.georeference import Georeference, write_georeference
from drsplat.formats.known import read_labels
from drsplat.formats.moving_scenes import write_moving
from drsplat.formats.tiles import Tiles
from drsplat.scene.eight_bits import clamped_in_bytes
from drsplat.scene.labelled import Annotation, LabelledScene, Thing
from drsplat.scene.moving import Frames, Moving
from glb_files import Read
from scenes import gaussians_at, random_gaussians
from toy_capture import PER_THING

HALF = np.float32([0, 0, 0.5])


def opened(room: Path) -> Scene:
    return open_scene(room / "room.field", scene=room / "scene.ply")


def edit(room: Path, *edits: Edit) -> None:
    file, scene = EditFile.beside(room / "scene.ply"), read_gaussians(room / "scene.ply")
    for one in edits:
        file.change(scene, lambda listed, one=one: listed.with_edit(one))


def read(path: Path) -> Read:
    return Read.of(path.read_bytes())


def exported(room: Path, capsys: Capture, *more: object) -> Read:
    out = room / "out.glb"
    answer_of(capsys, "export", room / "scene.ply", "--field", room / "room.field", *more, "-o", out, "--overwrite")
    return read(out)


def test_the_rows_of_the_table_are_the_objects_that_are_listed(room, capsys):
    answer_of(capsys, "objects", room / "room.field", "--id", 1, "--label", "<b>my</b> plate 😀")
    objects = answer_of(capsys, "objects", room / "room.field")["objects"]
    table = exported(room, capsys).table(0)
    assert table["number"] == [one["id"] for one in objects]
    assert table["name"] == [one["label"] or one["name"] or f"object {one['id']}" for one in objects]
    assert table["name"][1] == "<b>my</b> plate 😀"
    assert table["num_gaussians"] == [one["num_gaussians"] for one in objects]
    for column, key in (("center", "center"), ("extent", "extent"), ("score", "sure")):
        assert_allclose(table[column], [one[key] for one in objects], rtol=1e-6)


def test_an_answer_goes_along(room, capsys):
    scene = opened(room)
    answer = scene.ask("red mug")
    glb = exported(room, capsys, "--query", "red mug")
    assert_array_equal(glb.attribute("_RELEVANCY"), answer.dense)
    (match,) = scene.locate(answer)
    nodes = {node["name"]: node for node in glb.document["nodes"]}
    (number,) = nodes["matches"]["children"]
    assert_allclose(glb.document["nodes"][number]["translation"], match.center)
    assert_allclose(glb.document["nodes"][number]["scale"], match.extent)
    assert glb.document["nodes"][number]["extras"]["query"] == "red mug"


@pytest.mark.parametrize("chosen", [("--query", "red mug", "--only"), ("--object", 0)])
def test_only_a_part_is_written(room, capsys, chosen):
    scene = opened(room)
    glb = exported(room, capsys, *chosen)
    rows = object_rows(scene, 0) if chosen[0] == "--object" else None
    expected = scene.locate("red mug")[0].gaussian_ids if rows is None else np.flatnonzero(scene.object_ids() == 0)
    assert_array_equal(glb.attribute("POSITION"), scene.gaussians.means[expected])
    assert len(glb.table(0)["name"]) == 1
    assert set(glb.object_names()) == {glb.table(0)["name"][0]}


def test_a_label_is_written_alone_and_an_unknown_one_refused(room, capsys):
    answer_of(capsys, "objects", room / "room.field", "--id", 1, "--label", "my plate")
    glb = exported(room, capsys, "--label", "my plate")
    assert glb.table(0)["number"] == [1]
    error = error_of(
        capsys, "export", room / "scene.ply", "--field", room / "room.field", "--label", "x", "-o", room / "b.glb"
    )
    assert "nothing has the label 'x'" in error


def test_kept_edits_are_applied_and_boxes_follow(room, capsys):
    scene = opened(room)
    edit(
        room,
        Edit(object_rows(scene, 0), Move((0.0, 0.0, 2.0))),
        Edit(object_rows(scene, 0), Duplicate((3.0, 0.0, 0.0))),
        Edit(object_rows(scene, 1), Remove()),
    )
    assert (
        main(["export", str(room / "scene.ply"), "--field", str(room / "room.field"), "-o", str(room / "a.glb")]) == 0
    )
    assert "3 kept edits applied (--edits none to leave them out)" in capsys.readouterr().err
    table = read(room / "a.glb").table(0)
    first, second = scene.objects
    assert table["number"] == [0, 1, 2]
    assert table["name"][2] == f"copy of {table['name'][0]}"
    assert_allclose(table["center"][0], first.center + np.array([0, 0, 2]), atol=1e-4)
    assert_allclose(table["center"][2], first.center + np.array([3, 0, 2]), atol=1e-4)
    assert_allclose(table["extent"][2], first.extent, atol=1e-3)
    assert_allclose(table["center"][1], second.center, rtol=1e-6)  # removed: its number stays
    assert table["num_gaussians"] == [PER_THING, 0, PER_THING]


def test_edits_can_be_left_out(room, capsys):
    scene = opened(room)
    edit(room, Edit(object_rows(scene, 0), Remove()))
    arguments = ["export", str(room / "scene.ply"), "--output", str(room / "a.glb"), "--edits", "none"]
    assert main(arguments) == 0
    assert "1 kept edit left out" in capsys.readouterr().err
    assert_array_equal(read(room / "a.glb").attribute("POSITION"), scene.gaussians.means)
    answer = answer_of(capsys, "export", room / "scene.ply", "--output", room / "b.glb")
    assert (answer["num_edits"], answer["num_gaussians"]) == (1, len(scene.gaussians) - PER_THING)


def test_matches_follow_edits_and_vanish_with_them(room):
    scene = opened(room)
    (before,) = labelled(scene, "red mug").matches
    edit(room, Edit(object_rows(scene, 0), Move((0.0, 0.0, 2.0))))
    (after,) = labelled(scene, "red mug").matches
    assert_allclose(after.center - before.center, [0, 0, 2], atol=1e-4)
    edit(room, Edit(object_rows(scene, 0), Remove()))
    assert labelled(scene, "red mug").matches == ()
    with pytest.raises(InputError, match="nothing is left of what was chosen"):
        labelled(scene, "red mug", only="matches")


def test_a_saved_ply_of_edits_says_so_and_has_the_same_numbers(room, capsys):
    scene = opened(room)
    edit(room, Edit(object_rows(scene, 0), Duplicate((3.0, 0.0, 0.0))))
    base = (room / "scene.ply", "--field", room / "room.field")
    answer_of(capsys, "export", *base, "-o", room / "out.ply")
    answer_of(capsys, "edit", *base, "--save", room / "saved.ply")
    ours, saved = read_gaussians(room / "out.ply"), read_gaussians(room / "saved.ply")
    assert_array_equal(ours.extra["object_id"], saved.extra["object_id"])
    assert_array_equal(ours.means, saved.means)
    assert b"comment edited by drsplat" in (room / "out.ply").read_bytes()[:200]


def test_annotations_go_along_where_they_belong(room):
    scene = opened(room)
    center = scene.objects[0].center
    AnnotationFile.beside(room / "scene.ply").add([Annotation.at("on it", center), Annotation.at("far", center + 50)])
    assert [one.text for one in labelled(scene).annotations] == ["on it", "far"]
    assert [one.text for one in labelled(scene, only=object_rows(scene, 0)).annotations] == ["on it"]


def test_a_scene_without_a_field_is_written_as_it_is(room, capsys):
    scene = read_gaussians(room / "scene.ply")
    text = text_of(capsys, "export", room / "scene.ply", "-o", room / "a.glb")
    assert "It has no objects: `drsplat objects FIELD --scene SCENE` finds them" in text
    back = read_gaussians(room / "a.glb")
    assert back.fingerprint == scene.fingerprint
    for refused in (("--query", "red mug"), ("--object", 0), ("--embeddings",)):
        error = error_of(capsys, "export", room / "scene.ply", *refused, "-o", room / "b.glb")
        assert "pass --field FIELD" in error


def test_an_exported_file_answers_as_its_scene_does(room, capsys):
    """A GLB keeps every number, so the field of the scene is that of the file as well."""
    answer_of(capsys, "export", room / "scene.ply", "-o", room / "a.glb")
    found = answer_of(capsys, "locate", room / "room.field", "red mug", "--scene", room / "a.glb")
    expected = answer_of(capsys, "locate", room / "room.field", "red mug", "--scene", room / "scene.ply")
    assert found["matches"] == expected["matches"]
    assert answer_of(capsys, "inspect", room / "a.glb")["fingerprint"] == read_gaussians(room / "scene.ply").fingerprint


def test_inspect_shows_the_names(room, capsys):
    answer_of(capsys, "objects", room / "room.field", "--id", 1, "--label", "[red]plate[/red]")
    exported(room, capsys)
    answer = answer_of(capsys, "inspect", room / "out.glb")
    assert answer["objects"][1] == {"id": 1, "name": "[red]plate[/red]"}
    assert "1 [red]plate[/red]" in text_of(capsys, "inspect", room / "out.glb")


def test_embeddings_go_along_when_asked(room, capsys):
    assert "embedding" not in exported(room, capsys).table(0)
    objects = opened(room).field.objects
    rows = exported(room, capsys, "--embeddings").table(0)["embedding"]
    for row, node in zip(rows, objects.things.tolist(), strict=True):
        assert_array_equal(row, objects.descriptors_of(node)[0])


def test_a_scene_that_moves_is_written_at_a_time(room, capsys):
    scene = read_gaussians(room / "scene.ply")
    later = replace(scene, means=scene.means + np.float32([0, 0, 1]))
    times = np.array([0.0, 1.0])
    moving = Moving(scene, times, Frames(times, (scene, later).__getitem__))
    write_moving(room / "film.motion", moving)
    base = ("export", room / "room.field", "--scene", room / "film.motion", "-o", room / "a.glb")
    assert "this scene moves" in error_of(capsys, *base)
    answer_of(capsys, *base, "--at", 0.5)
    glb = read(room / "a.glb")
    assert_allclose(glb.attribute("POSITION"), scene.means + HALF, atol=1e-6)
    assert_allclose(glb.table(0)["center"][0], opened(room).objects[0].center + HALF, atol=1e-4)
    error = error_of(capsys, "export", room / "scene.ply", "-o", room / "b.glb", "--at", 0.5)
    assert "this scene stands still" in error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "a.gbl"), "Did you mean '.glb'"),
        (("-o", "a.obj"), "expected a name that ends in"),
        (("-o", "a.tiles"), "A folder of 3D Tiles is written with --tiles3d"),
        (("-o", "nowhere/a.glb"), "there is no folder"),
        (("-o", "a.glb", "--only"), "give --query WORDS"),
        (("-o", "a.glb", "--object", "99"), "there is no object 99"),
        (("-o", "a.glb", "--query", "blue plate", "--threshold", "1", "--only"), "nothing to export"),
        (("-o", "a.glb", "--only", "--object", "0"), "keep one of them"),
    ],
)
def test_what_cannot_be_written_is_said(arguments, message, room, capsys, monkeypatch):
    monkeypatch.chdir(room)
    before = sorted(room.iterdir())
    error = error_of(capsys, "export", "scene.ply", "--field", "room.field", *arguments)
    assert message in error
    assert sorted(room.iterdir()) == before


def test_in_python(room):
    scene = opened(room)
    done = export(room / "a.glb", scene, "red mug", only="matches")
    assert (done.format, done.num_objects, done.num_matches, done.lacks) == ("glb", 1, 1, ())
    assert done.bytes == (room / "a.glb").stat().st_size
    assert export(room / "b.spz", scene).lacks == (
        ".spz keeps no object of each Gaussian",
        ".spz keeps no names and boxes of objects",
    )
    assert export(room / "c.glb", scene.gaussians).num_objects == 0
    assert export(room / "d.glb", labelled(scene, time=None)).num_gaussians == len(scene.gaussians)
    with pytest.raises(InputError, match="answered by a field"):
        export(room / "e.glb", scene.gaussians, "red mug")


def test_groups_that_a_part_is_in_stay_with_it():
    def thing(name, parent, number=-1):
        return Thing(name, 1.0, np.zeros(3), np.eye(3), np.ones(3), parent, None, number)

    things = (thing("a", 2, 0), thing("b", 0, 1), thing("c", -1, 2))
    groups = (thing("g0", -1), thing("g1", -1), thing("g2", 1))
    gaussians = gaussians_at(np.zeros((2, 3)))
    part = only_used(LabelledScene(gaussians, "s", things, groups, np.int32([0, -1])))
    assert [(one.name, one.parent, one.number) for one in part.things] == [("a", 1, 0)]
    assert [(one.name, one.parent) for one in part.groups] == [("g1", -1), ("g2", 0)]
    assert part.object_of.tolist() == [0, -1]


def test_columns_of_the_file_go_along_in_a_ply_alone(room, capsys):
    scene = read_gaussians(room / "scene.ply")
    write_gaussians(room / "more.ply", scene, {"age": np.arange(len(scene), dtype=np.float32)})
    answer = answer_of(capsys, "export", room / "more.ply", "-o", room / "a.glb")
    assert answer["lacks"] == [".glb keeps no further columns of the scene"]
    answer_of(capsys, "export", room / "more.ply", "-o", room / "a.ply")
    assert_array_equal(read_gaussians(room / "a.ply").extra["age"], np.arange(len(scene)))


def test_colors_can_be_fitted_to_bytes(room, capsys):
    gaussians = read_gaussians(room / "scene.ply")
    bright = room / "bright.ply"
    write_gaussians(bright, replace(gaussians, sh=gaussians.sh + np.float32(2)))
    answer_of(capsys, "export", bright, "-o", room / "as_it_is.glb")
    answer_of(capsys, "export", bright, "--fit-8bit", "-o", room / "fitted.glb")
    export(room / "python.glb", read_gaussians(bright), fit_8bit=True)
    clamped = [
        clamped_in_bytes(read_gaussians(room / f"{name}.glb")).sum() for name in ("as_it_is", "fitted", "python")
    ]
    assert clamped[0] > 0
    assert clamped[1:] == [0, 0]


@pytest.mark.parametrize(
    ("suffix", "more"), [("glb", ()), ("ply", ()), ("usda", ()), ("sog", ()), ("spz", ("--spz-version", 4))]
)
def test_names_come_back_from_every_format_that_holds_them(room, capsys, suffix, more):
    if suffix == "usda":
        pytest.importorskip("pxr")
    scene, out = opened(room), room / f"part.{suffix}"
    answer_of(capsys, "objects", room / "room.field", "--id", 1, "--label", 'a/b "plate" 😀')
    given = ("--field", room / "room.field", "--object", 1, *more)
    assert answer_of(capsys, "export", room / "scene.ply", *given, "-o", out)["lacks"] == []
    told = answer_of(capsys, "inspect", out)
    assert told["objects"] == [{"id": 1, "name": 'a/b "plate" 😀'}]
    read = read_gaussians(out)
    assert told["num_gaussians"] == len(read)
    assert set(read.extra["object_id"].tolist()) <= {1, -1}
    assert (read.extra["object_id"] == 1).sum() == (scene.object_ids() == 1).sum()


def test_a_file_with_objects_is_exported_with_them_again(room, capsys):
    """From format to format, without the field; after an edit the boxes are where the Gaussians are."""
    answer_of(capsys, "export", room / "scene.ply", "--field", room / "room.field", "-o", room / "0.glb")
    chain = [("1.sog", ()), ("2.spz", ("--spz-version", 4)), ("2b.ply", ()), ("3.usda", ()), ("4.glb", ())]
    if find_spec("pxr") is None:
        chain.remove(("3.usda", ()))
    for place, (name, more) in enumerate(chain):
        source = room / ("0.glb" if not place else chain[place - 1][0])
        assert answer_of(capsys, "export", source, *more, "-o", room / name)["lacks"] == []
    first, last = read(room / "0.glb").table(0), read(room / "4.glb").table(0)
    for column in ("name", "number", "center", "extent", "axes", "score", "num_gaussians"):
        assert_array_equal(first[column], last[column])
    file, scene = EditFile.beside(room / "4.glb"), read_gaussians(room / "4.glb")
    moved = Rows.of(np.flatnonzero(scene.extra["object_id"] == 0))
    file.change(scene, lambda listed: listed.with_edit(Edit(moved, Move((0.0, 0.0, 2.0)))))
    assert answer_of(capsys, "export", room / "4.glb", "-o", room / "5.glb")["num_edits"] == 1
    assert_allclose(read(room / "5.glb").table(0)["center"][0], np.add(last["center"][0], [0, 0, 2]), atol=2e-2)


def test_a_copy_in_a_file_of_one_object_is_named_after_it(room, capsys):
    """Its number is not its place in the table."""
    given = ("--field", room / "room.field", "--object", 1)
    answer_of(capsys, "export", room / "scene.ply", *given, "-o", room / "part.glb")
    (name,) = read(room / "part.glb").table(0)["name"]
    file, scene = EditFile.beside(room / "part.glb"), read_gaussians(room / "part.glb")
    owned = Rows.of(np.flatnonzero(scene.extra["object_id"] == 1))
    file.change(scene, lambda listed: listed.with_edit(Edit(owned, Duplicate((3.0, 0.0, 0.0)))))
    answer_of(capsys, "export", room / "part.glb", "-o", room / "two.glb")
    table = read(room / "two.glb").table(0)
    assert (table["number"], table["name"]) == ([1, 2], [name, f"copy of {name}"])


def test_labels_of_numbers_that_no_gaussian_has_are_refused(room, capsys):
    pytest.importorskip("pxr")
    answer_of(capsys, "export", room / "scene.ply", "--field", room / "room.field", "-o", room / "a.usda")
    text = (room / "a.usda").read_text()
    for lie in ("int drsplat:number = 4294967295", "int drsplat:number = -2"):
        (room / "b.usda").write_text(text.replace("int drsplat:number = 1", lie))
        assert (room / "b.usda").read_text() != text
        assert "and a number from -1 to 2147483647" in error_of(capsys, "export", room / "b.usda", "-o", room / "c.glb")
    assert not (room / "c.glb").exists()


def test_three_d_tiles_by_the_verb_stand_where_the_scene_lies(room, capsys):
    given = ("--field", room / "room.field", "--tiles3d")
    answer = answer_of(capsys, "export", room / "scene.ply", *given, "-o", room / "free")
    assert (answer["format"], answer["num_gaussians"], answer["num_objects"]) == ("3D Tiles", 2 * PER_THING, 2)
    free = json.loads((room / "free" / "tileset.json").read_text())
    write_georeference(room, Georeference(4.36, 52.0, 1.0, np.eye(3), 1.0))
    answer_of(capsys, "export", room / "scene.ply", *given, "-o", room / "placed")
    placed = json.loads((room / "placed" / "tileset.json").read_text())
    assert np.linalg.norm(placed["root"]["transform"][12:15]) == pytest.approx(6.365e6, rel=2e-3)
    assert np.linalg.norm(free["root"]["transform"][12:15]) < 100
    assert "exists already" in error_of(capsys, "export", room / "scene.ply", *given, "-o", room / "free")


def test_tiles_become_3d_tiles_without_a_field(room, capsys):
    answer_of(capsys, "tile", room / "scene.ply", "--output", room / "tiles")
    answer = answer_of(capsys, "export", room / "tiles", "--tiles3d", "-o", room / "tileset")
    assert (answer["num_gaussians"], answer["num_objects"]) == (2 * PER_THING, None)
    assert "fit_8bit" in error_of(capsys, "export", room / "tiles", "--tiles3d", "--fit-8bit", "-o", room / "again")


def test_tiles_become_3d_tiles_with_the_objects_of_their_field(room, capsys):
    """None of them is loaded with all others: the scene's own Gaussians are never asked for."""
    answer_of(capsys, "tile", room / "scene.ply", "--output", room / "tiles")
    answer_of(capsys, "field", "carry", room / "room.field", room / "tiles", "--scene", room / "scene.ply",
              "--output", room / "tiles.field")  # fmt: skip
    with patch.object(Tiles, "gaussians", side_effect=AssertionError):
        answer = answer_of(
            capsys, "export", room / "tiles", "--field", room / "tiles.field", "--tiles3d", "-o", room / "tileset"
        )
        same = answer_of(
            capsys, "export", room / "tiles.field", "--scene", room / "tiles", "--tiles3d", "-o", room / "same"
        )
    scene = open_scene(room / "tiles.field")
    assert answer["num_objects"] == same["num_objects"] == len(scene.objects) > 1
    assert answer["num_in_objects"] == (scene.object_ids() >= 0).sum()
    names = {name for path in (room / "tileset").glob("*.glb") for name in read(path).table(0)["name"]}
    assert len(names) == answer["num_objects"]
    assert "belongs to" in error_of(
        capsys, "export", room / "tiles", "--field", room / "room.field", "--tiles3d", "-o", room / "other"
    )


def test_a_file_beside_its_scene_does_not_take_its_place(room, capsys):
    (room / "a_mesh.glb").write_bytes(b"glTF" + bytes(40))
    answer_of(capsys, "export", room, "-o", room / "a.glb")
    assert answer_of(capsys, "edit", room, "--object", 0, "--remove")["scene"] == str(room / "scene.ply")


def test_names_beside_a_ply_follow_its_edits(room, capsys):
    """Of the PLY alone, without the field that they are from."""
    answer_of(capsys, "export", room / "scene.ply", "--field", room / "room.field", "-o", room / "named.ply")
    answer_of(capsys, "edit", room / "named.ply", "--everything", "--move", 1, 0, 0)
    answer_of(capsys, "export", room / "named.ply", "-o", room / "edited.ply")
    before, after = (read_labels(room / f"{name}.ply") for name in ("named", "edited"))
    assert [one.name for one in before.things] == [one.name for one in after.things]
    assert len(before.things) == 2
    for one, moved in zip(before.things, after.things, strict=True):
        assert_allclose(moved.center, np.add(one.center, (1, 0, 0)), atol=0.05)
    (room / "edited.objects.json").write_text("{")
    assert "edited.objects.json" in error_of(capsys, "inspect", room / "edited.ply")


def test_a_plain_ply_has_the_rows_that_the_numbers_beside_it_are_of(room, capsys):
    """For importers that refuse further columns, as docs/export.md says."""
    answer_of(capsys, "export", room / "scene.ply", "-o", room / "plain.ply")
    answer_of(capsys, "objects", room / "room.field", "--scene", room / "scene.ply", "--save", room / "ids.npy")
    answer_of(capsys, "export", room / "scene.ply", "--field", room / "room.field", "-o", room / "named.ply")
    plain, named = read_gaussians(room / "plain.ply"), read_gaussians(room / "named.ply")
    assert not plain.extra
    assert not (room / "plain.objects.json").exists()
    assert_array_equal(plain.means, named.means)
    assert_array_equal(np.load(room / "ids.npy"), named.extra["object_id"])


def test_objects_that_there_are_not_are_refused():
    for wrong, said in (({"object_of": np.zeros(2, np.int32)}, "from -1 to -1"),
                        ({"relevancy": np.zeros(3, np.float32)}, "expected 2 numbers")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            LabelledScene(random_gaussians(2), **wrong)
