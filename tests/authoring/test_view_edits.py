"""Edits, annotations and the list of objects in the viewer and in its pages, without a browser."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import export_page, open_scene, read_gaussians
from drsplat.authoring.editing import Copies, Duplicate, Edit, EditFile, Move, Remove
from drsplat.formats.annotations import AnnotationFile
from drsplat.fronts.viewing import saving
from drsplat.fronts.viewing.session import Mode, Session
from drsplat.fronts.viewing.stage import Stage
from drsplat.scene.labelled import Annotation
from page_files import read_page
from refusing import refused
from toy_capture import PER_THING, THINGS
from viewing_scenes import EACH, boxes_scene

UP = np.array([0.0, 0, 1])


def session_of(room: Path) -> Session:
    return Session(open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture"))


@pytest.fixture
def session() -> Session:
    """Of a scene without a file: its edits are in memory."""
    return Session(boxes_scene())


def test_what_is_moved_is_drawn_and_met_where_it_is_now(session):
    session.ask("red mug")
    before = session.drawn
    session.edit(Move((0.0, 0.0, 5.0)))
    moved = np.arange(EACH)
    up = session.drawn.centers[moved] - before.centers[moved]
    assert_allclose(up, np.broadcast_to([0, 0, 5 * before.frame.scale], up.shape), atol=1e-3)
    assert_array_equal(session.drawn.centers[EACH : 2 * EACH], before.centers[EACH : 2 * EACH])
    eye = session.shown.frame.shown(np.array([-1.0, -4, 5]))
    hit = session.click(eye, np.array([0.0, 1, 0]))
    assert hit.point[2] > 4
    session.edits.undo()
    assert session.drawn is before
    assert session.click(eye, np.array([0.0, 1, 0])) is None


def test_boxes_are_where_things_are_now(session):
    session.ask("red mug")
    match = session.results[0].matches[0]
    session.edit(Move((0.0, 0.0, 5.0)))
    session.ask("red mug; tall lamp")
    mug, lamp = (result.matches[0] for result in session.results)
    stage = Stage.of(session)
    assert_allclose(stage.placed(mug).center, match.center + np.array([0, 0, 5]), atol=1e-3)
    assert_allclose(stage.placed(mug).extent, match.extent, atol=1e-3)
    assert stage.placed(lamp) is lamp


def test_copies_are_drawn_painted_and_saved(session, tmp_path):
    session.ask("red mug")
    count = len(session.scene.gaussians)
    session.edit(Duplicate((0.5, 0.0, 0.5)))
    added = session.edits.listed.edits[0].target
    assert len(session.drawn) == count + len(added)
    assert session.drawn_colors.shape == (len(session.drawn), 3)
    session.mode = Mode.ANSWER
    assert session.colors.shape == (count, 3)
    view = session.scene.views[0].resized(160, 112)
    with_copy = saving.picture_of(session, view)
    session.edits.add(Edit(Copies(1), Remove()))
    assert not np.array_equal(saving.picture_of(session, view), with_copy)
    session.edits.undo()
    saving.save_scene(tmp_path / "all.ply", session)
    saved = read_gaussians(tmp_path / "all.ply")
    assert len(saved) == len(session.drawn)
    assert (saved.extra["match_id"][count:] == -1).all()
    assert (saved.extra["match_id"][:EACH] == 0).all()


def test_the_list_is_the_one_beside_the_scene(room):
    session = session_of(room)
    session.ask("red mug")
    session.edit(Remove())
    file = EditFile.beside(room / "scene.ply")
    assert file.read(session.scene.gaussians).done == 1
    again = session_of(room)
    assert (~again.edits.present).sum() == PER_THING
    again.edits.undo()
    assert again.edits.present.all()
    assert file.read(session.scene.gaussians).done == 0
    again.choose_object(1)
    again.edit(Remove())
    (edit,) = file.read(session.scene.gaussians).active
    assert str(edit.target) == "object 1"


def test_the_same_edits_of_rows_that_are_elsewhere(session):
    session.ask("red mug")
    session.edit(Duplicate((0.5, 0.0, 0.5)))
    scene = session.scene.gaussians
    later = replace(scene, means=scene.means + np.float32([0, 1, 0]))
    edits = session.edits
    now, listed = edits.part(None)[0], edits.listed
    edits.stand(later)
    assert_allclose(edits.part(None)[0].means, now.means + np.float32([0, 1, 0]), atol=1e-6)
    assert edits.listed is listed


def test_what_fails_leaves_all_as_it_was(room):
    session = session_of(room)
    with refused("nothing is selected"):
        session.edit(Remove())
    session.ask("red mug")
    with refused("beyond all numbers"):
        session.edit(Move((1e39, 0.0, 0.0)))
    assert not session.edits.is_edited
    assert not (room / "scene.edits.json").exists()


def test_annotations_are_kept(room, session):
    stored = session_of(room)
    for one in (session, stored):
        one.edits.annotate(Annotation.at("a", (1, 2, 3)), Annotation.at("b", (1, 2, 3)))
        one.edits.drop(1)
        assert [note.text for note in one.edits.annotations] == ["b"]
        with refused("no annotation 2"):
            one.edits.drop(2)
    assert [note.text for note in AnnotationFile.beside(room / "scene.ply").read()] == ["b"]
    assert [note.text for note in session_of(room).edits.annotations] == ["b"]


def test_a_page_has_objects_annotations_and_the_scene_as_edited(room):
    session = session_of(room)
    session.ask("blue plate")
    session.edit(Duplicate((0.0, 0.0, 1.0)))
    session.edits.annotate(Annotation.at("<here>", (0.0, 0.0, 1.0)))
    scene = open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture")
    page = export_page(room / "page.html", scene, ["red mug"])
    header = read_page(room / "page.html")[0]
    assert len(page.shown) == 3 * PER_THING
    assert [(one["name"], one["unsure"]) for one in header["objects"]] == [("object 0", False), ("object 1", False)]
    assert all(one["picture"].startswith("data:image/jpeg;base64,") for one in header["objects"])
    assert [one["text"] for one in header["annotations"]] == ["<here>"]
    numbers = page.rows["objects"]
    assert np.bincount(numbers).tolist() == [PER_THING, PER_THING, PER_THING]
    frame = page.shown.frame
    middle = frame.world(np.array(header["objects"][0]["center"]))
    assert min(np.linalg.norm(middle - np.array(at)) for at in THINGS.values()) < 0.1
    assert "<here>" not in (room / "page.html").read_text(encoding="utf-8")  # it is JSON in a script


def test_a_scene_without_objects_lists_none(session, tmp_path):
    header = export_page(tmp_path / "page.html", session.scene, ["red mug"]).header
    assert header["objects"] == header["annotations"] == []
