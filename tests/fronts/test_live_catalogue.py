"""Many scenes in the live viewer: a query, thumbnails, and the scene of one of them."""

import io
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_catalogue import WORDS

from catalogued import boxes_of, write_scene
from clients import Browser, Viewer, a_viewer
from clients import error_of as refusal_of
from command_line import error_of
from drsplat import read_gaussians
from drsplat.query.catalogue import Catalogue


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("many")
    catalogue = Catalogue.open(made / "flats.catalogue")
    for number, (name, words) in enumerate(WORDS.items()):
        catalogue.add(write_scene(made / name, words, moved=10.0 * number))
    return made


@pytest.fixture
def viewer(folder: Path) -> Iterator[Viewer]:
    """With no scene open."""
    with a_viewer(catalogue=Catalogue.open(folder / "flats.catalogue")) as one:
        one.shared._stage = None
        yield one


def scenes_of(viewer: Viewer, text: str) -> list[str]:
    answer = viewer.post("/view/catalogue", {"text": text})
    assert answer.status_code == 200, answer.text
    return [entry["scene"] for entry in answer.json()["entries"]]


def test_answers_have_thumbnails(viewer):
    assert viewer.header()["can"]["catalogue"]
    assert scenes_of(viewer, "mug") == ["kitchen", "o'hara"]
    for number in range(2):
        picture = viewer.get("/view/catalogue-picture", number=number)
        with Image.open(io.BytesIO(picture.content)) as opened:
            assert (opened.format, opened.size) == ("JPEG", (240, 180))
    assert "no entry 2" in refusal_of(viewer.get("/view/catalogue-picture", number=2), 422)
    assert scenes_of(viewer, "elephant") == []
    assert "0 matches" in viewer.post("/view/catalogue", {"text": "elephant"}).json()["summary"]
    refusal_of(viewer.post("/view/catalogue", {"text": "point, not"}), 422)


def test_each_browser_opens_what_it_has_found_itself(viewer):
    one, other = Browser(viewer), Browser(viewer)
    assert scenes_of(one, "mug") == ["kitchen", "o'hara"]
    assert "no entry 0" in other.refused("open_entry", number=0)
    scenes_of(other, "elephant")
    one.do("open_entry", number=1)
    assert (one.state()["selection"] > 0, other.state()["selection"]) == (True, 0)  # the scene is open for all


def test_an_entry_opens_its_scene_at_the_object(viewer):
    assert "no entry 0" in viewer.refused("open_entry", number=0)
    scenes_of(viewer, "mug")
    state = viewer.do("open_entry", number=1)
    session = viewer.session
    assert session.scene.name == "o'hara"
    np.testing.assert_array_equal(session.selection, session.scene.objects[0].gaussian_ids)
    assert state["chosen"]["number"] == 0
    assert "o'hara" in state["message"]
    again = viewer.do("open_entry", number=1)
    assert viewer.session is session  # it is there already
    assert again["scene"] == state["scene"]
    assert viewer.do("open_entry", number=0)["scene"] == state["scene"] + 1
    assert viewer.session.scene.name == "kitchen"
    assert len(viewer.arrays("/view/splats")["opacity"]) == len(viewer.session.drawn)


def test_a_scene_that_changed_or_went_is_told_without_its_folder(viewer, folder):
    gaussians = read_gaussians(folder / "kitchen/scene.ply")
    shutil.copytree(folder / "kitchen/a.field", folder / "before")
    scenes_of(viewer, "red mug")
    boxes_of(("red bowl", "red rug", "red sofa"), gaussians).save(folder / "kitchen/a.field", overwrite=True)
    try:
        assert "has changed since" in viewer.do("open_entry", number=0)["message"]
        (folder / "kitchen").rename(folder / "gone")
        viewer.shared.entry, stage = ("", ""), viewer.shared._stage
        viewer.shared._stage = None
        said = viewer.refused("open_entry", number=0)
        assert "where nothing is any more" in said
        assert str(folder) not in said
        viewer.shared._stage = stage
        assert viewer.session.scene.name == "kitchen"
    finally:
        (folder / "gone").rename(folder / "kitchen")
        shutil.rmtree(folder / "kitchen/a.field")
        (folder / "before").rename(folder / "kitchen/a.field")


def test_the_command_line(folder, capsys):
    assert "expected a scene, or --catalogue" in error_of(capsys, "view")
    assert "expected a scene, or --catalogue" in error_of(capsys, "view", folder, "--catalogue", folder)
    for option, value in (("--up", "+z"), ("--ask", "mug")):
        said = error_of(capsys, "view", "--catalogue", folder / "flats.catalogue", option, value)
        assert f"{option} is of one scene" in said
    assert "no catalogue is here" in error_of(capsys, "view", "--catalogue", folder / "none")
