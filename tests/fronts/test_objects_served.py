"""Objects over HTTP and for language models: what Python, the command line and both services tell is the same."""

import io
import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from callers import Service, reply_of, told
from drsplat import read_gaussians, write_gaussians
from drsplat.errors import InputError
from drsplat.formats.poses import write_cameras_json
from drsplat.fronts.serving.conversation import Conversation
from drsplat.fronts.serving.guards import Limits
from drsplat.fronts.serving.query_fields import Export
from drsplat.fronts.serving.scene_folder import SceneFolder
from drsplat.fronts.serving.worker import COMPLETING_S, WRITING_S, exported
from drsplat.query import open_scene
from drsplat.query.documents import object_documents
from glb_files import Read
from known_objects import CENTERS, EACH, VIEWS, described, known_field, known_scene
from scenes import look_at_view

ALL = {"all": False}
EYES = ((0.5, -4.0, 1.5), (1.5, -4.5, 2.0), (2.5, -4.0, 1.0))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene as `drsplat register` and `drsplat objects` leave it."""
    gaussians = replace(known_scene(), scales=np.full((3 * EACH, 3), 0.02, np.float32))
    write_gaussians(tmp_path / "scene.ply", gaussians)
    field = known_field(gaussians)
    field.with_objects(described(field, read_gaussians(tmp_path / "scene.ply"))).save(tmp_path / "a.field")
    (tmp_path / "images").mkdir()
    views = [replace(look_at_view(eye, (1.5, 0, 0)), name=name) for eye, name in zip(EYES, VIEWS, strict=True)]
    write_cameras_json(tmp_path / "cameras.json", views)
    for view in views:
        Image.new("RGB", (view.width, view.height), (90, 140, 200)).save(tmp_path / "images" / view.name)
    return tmp_path


def talk_of(folder: Path) -> Conversation:
    return Conversation(open_scene(folder), folder.name)


def test_the_same_list_everywhere(folder):
    scene = open_scene(folder)
    scene.label(scene.field.objects.thing(1), "mug")
    listed = json.loads(reply_of(folder, "objects", ALL).body)
    assert listed == talk_of(folder).list_objects(20).model_dump()
    assert listed["num_objects"] == 3
    room = open_scene(folder)
    for one, expected in zip(listed["objects"], object_documents(room, room.objects), strict=True):
        for key in ("id", "label", "name", "num_gaussians", "num_views", "views"):
            assert one[key] == expected[key]
        for key in ("center", "extent", "axes", "sure"):
            np.testing.assert_allclose(one[key], expected[key], atol=2e-4)
    assert [one["label"] for one in listed["objects"]] == [None, "mug", None]


def test_a_new_name_is_told_without_a_restart(folder):
    scene_folder = SceneFolder(folder)
    assert json.loads(reply_of(scene_folder, "objects", ALL).body)["objects"][0]["label"] is None
    scene = open_scene(folder)
    scene.label(scene.field.objects.thing(0), "bowl")
    assert json.loads(reply_of(scene_folder, "objects", ALL).body)["objects"][0]["label"] == "bowl"


def test_one_object(folder):
    picture = reply_of(folder, "object-picture", {"number": 2})
    assert picture.media_type == "image/jpeg"
    image = Image.open(io.BytesIO(picture.body))
    assert (image.format, image.size) == ("JPEG", (640, 480))
    pixels = np.asarray(image).astype(int)
    assert np.abs(pixels[240, 320] - (90, 140, 200)).max() < 30  # lit in the middle
    assert pixels[5, 5].min() > 200  # pale around
    ply = reply_of(folder, "object-ply", {"number": 2})
    (folder / "out.ply").write_bytes(ply.body)
    part = read_gaussians(folder / "out.ply")
    assert len(part) == EACH - 10
    np.testing.assert_allclose(part.positions.mean(axis=0), CENTERS[2], atol=0.02)


@pytest.mark.parametrize("act", ["object-picture", "object-ply"])
def test_objects_that_are_not_there(act, folder):
    refused = reply_of(folder, act, {"number": 3})
    assert refused.status == 422
    assert "there are 0 to 2" in json.loads(refused.body)["error"]


def test_a_field_without_objects_says_what_to_do(folder):
    scene = open_scene(folder)
    scene.field.with_objects(None).save(folder / "a.field", overwrite=True)
    refused = reply_of(folder, "objects", ALL)
    assert refused.status == 422
    assert "drsplat objects" in json.loads(refused.body)["error"]
    with pytest.raises(InputError, match="drsplat objects"):
        talk_of(folder).list_objects(20)


def test_relations_by_number_and_by_name(folder):
    scene = open_scene(folder)
    scene.label(scene.field.objects.thing(2), "Far Box")
    talk = talk_of(folder)
    between = talk.relations("between", "0", "far box")
    assert between.to == [0, 2]
    assert [one.id for one in between.objects] == [1]
    assert talk.relations("on", "1").objects == []
    assert "list_objects" in talk.relations("on", "1").advice
    with pytest.raises(InputError, match="there is no object 7"):
        talk.relations("on", "7")
    with pytest.raises(InputError, match="expected two objects"):
        talk.relations("between", "1")


def test_long_lists_are_cut(folder):
    listed = talk_of(folder).list_objects(2)
    assert (listed.num_objects, [one.id for one in listed.objects]) == (3, [0, 1])
    assert listed.advice == "the 2 largest of 3"


@pytest.mark.slow
def test_routes(folder):
    with closing(Service(folder)) as service:
        listed, picture, ply, none, bad = (
            service("GET", f"/scenes/{folder.name}/objects{path}")
            for path in ("", "/0/picture", "/0/ply", "/9/ply", "/x/ply")
        )
    assert told(listed)["num_objects"] == 3
    assert listed.headers["x-drsplat-field"] == listed.json()["field"]
    assert (picture.status_code, picture.headers["content-type"]) == (200, "image/jpeg")
    assert ply.content.startswith(b"ply\n")
    assert (none.status_code, bad.status_code) == (422, 422)


def test_what_photos_agree_less_on_is_listed_when_it_is_asked_for(folder):
    field = open_scene(folder).field
    sure = field.objects.sure.copy()
    sure[field.objects.thing(0)] = 0.1
    field.with_objects(replace(field.objects, sure=sure)).save(folder / "a.field", overwrite=True)
    listed, every = (json.loads(reply_of(folder, "objects", {"all": all}).body) for all in (False, True))
    assert (listed["num_objects"], listed["num_agreed"]) == (every["num_objects"], every["num_agreed"]) == (3, 2)
    assert [one["id"] for one in listed["objects"]] == [1, 2]
    assert [(one["id"], one["agreed"]) for one in every["objects"]] == [(0, False), (1, True), (2, True)]
    assert "1 more that photos agree less on: all=true" in listed["advice"]
    talk = talk_of(folder)
    assert [one.id for one in talk.list_objects(20).objects] == [1, 2]
    assert talk.list_objects(1).advice.startswith("the 1 largest of 2. 1 more that photos agree less on")
    assert [one.id for one in talk.list_objects(20, unsure=True).objects] == [0, 1, 2]


def test_a_scene_is_sent_as_a_file_with_its_names(folder):
    sent = reply_of(folder, "export", {})
    assert sent.media_type == "model/gltf-binary"
    assert sent.field == open_scene(folder).field.fingerprint
    assert Read.of(sent.body).table(0)["number"] == [0, 1, 2]
    one = Read.of(reply_of(folder, "export", {"object": 2}).body)
    assert one.table(0)["number"] == [2]
    ply = reply_of(folder, "export", {"format": "ply"})
    assert ply.body.startswith(b"ply\n")
    assert ply.media_type == "application/octet-stream"


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"only": True}, "what matches is that of a query"),
        ({"object": 3}, "there are 0 to 2"),
        ({"time": 1.0}, "this scene stands still"),
    ],
)
def test_a_file_that_cannot_be_is_refused(asked, message, folder):
    refused = reply_of(folder, "export", asked)
    assert refused.status == 422
    assert message in json.loads(refused.body)["error"]


def test_a_scene_that_is_too_large_is_not_sent(folder):
    with pytest.raises(InputError, match=r"up to 0 are sent: `drsplat export` writes it"):
        exported(open_scene(folder), Export(), Limits(file_bytes=100))


def test_a_file_that_takes_too_long_is_refused_before_it_begins(folder):
    """It was computed until the time was over, in one of two processes."""
    scene = open_scene(folder)
    whole_s, part_s = (len(scene.gaussians) * each for each in (WRITING_S, WRITING_S + COMPLETING_S))
    limits, one = Limits(seconds=(whole_s + part_s) / 2), Export(object=2, format="ply")
    assert exported(scene, Export(), limits).body
    with pytest.raises(InputError, match=r"`drsplat export FOLDER --object 2 --edits none -o scene.ply` does it"):
        exported(scene, one, limits)
    assert exported(scene, one, Limits(seconds=2 * part_s)).body
    with pytest.raises(InputError, match=r"`drsplat export FOLDER --edits kept -o scene.glb` does it"):
        exported(scene, Export(edits="kept"), Limits(seconds=whole_s / 2))
