"""The gallery: what is asked of a room, a page and its picture, and the site's page of them."""

import os
from pathlib import Path

import pytest
from PIL import Image
from scripts import make_gallery

from viewing_scenes import boxes_scene

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", make_gallery.SCENES)
def test_what_is_asked_is_in_the_room_but_the_last(name):
    truth = make_gallery.read_truth(make_gallery.SCENES[name])
    *shown, absent = make_gallery.queries_of(make_gallery.SCENES[name], truth)
    assert len(shown) == make_gallery.NUM_QUERIES
    assert set(shown) <= set(truth.categories.values())
    assert not any(absent in category for category in truth.categories.values())
    assert len(truth.held_out) >= 3


def test_the_demo_is_asked_for_what_is_large():
    source = make_gallery.SCENES["demo"]
    asked = make_gallery.queries_of(source, make_gallery.read_truth(source))
    assert {"orange sofa", "red vase"} <= set(asked)


def test_a_page_and_its_picture(tmp_path):
    scene = boxes_scene()
    told = make_gallery.entry("boxes", scene, ["red mug", "tall lamp", "elephant"], tmp_path)
    assert told["matches"] == {"red mug": 1, "tall lamp": 1, "elephant": 0}
    assert told["page_bytes"] == (tmp_path / "boxes.html").stat().st_size
    assert told["num_shown"] == len(scene.gaussians)
    with Image.open(tmp_path / "boxes.jpg") as picture:
        assert max(picture.size) <= make_gallery.WIDTH
    (tmp_path / make_gallery.LIST).write_text(make_gallery.as_text([told]))
    assert make_gallery.read_list(tmp_path) == [told]
    (tmp_path / "boxes.html").unlink()
    assert make_gallery.read_list(tmp_path) == []


def test_a_page_is_made_again_when_the_package_has_changed(tmp_path):
    package, page = tmp_path / "package", tmp_path / "page.html"
    (package / "__pycache__").mkdir(parents=True)
    for number, file in enumerate((package / "a.py", page, package / "__pycache__/a.pyc"), 1):
        file.touch()
        os.utime(file, (number, number))
    assert not make_gallery.is_older(page, package)
    os.utime(package / "a.py", (9, 9))
    assert make_gallery.is_older(page, package)
