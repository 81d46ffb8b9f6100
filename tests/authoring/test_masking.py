"""Masks of photos drawn from a query or from all objects, and read back as masks."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_array_equal
from PIL import Image

from command_line import answer_of, error_of
from drsplat import Scene, View, open_scene, read_views
from drsplat.authoring.exporting.masking import NAMES, write_masks
from drsplat.drawing.pictures import visible_share
from drsplat.scene.photo_masks import load_mask
from drsplat.scene.photos import undistort_ids
from refusing import refused

LENS = (-2.0, 0.5, 0.02, -0.01)


def numbers(folder: Path, view: View) -> np.ndarray:
    return np.asarray(Image.open(folder / f"{view.name}.png"))


def opened(room: Path) -> Scene:
    return open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture")


def test_masks_of_a_query_are_what_training_reads(room, capsys):
    line = ["export", room / "room.field", "--scene", room / "scene.ply", "--views", room / "capture", "--masks"]
    answer = answer_of(capsys, *line, "--query", "red mug", "--output", room / "capture/masks")
    scene = opened(room)
    assert (answer["num_photos"], answer["num_shown"]) == (len(scene.views), len(scene.views))
    red = scene.locate("red mug")[0].gaussian_ids
    for view in read_views(room / "capture"):
        mask = load_mask(view)
        share = visible_share(scene.gaussians, view, red)
        assert mask[share > 0.6].all()
        assert not mask[share < 0.4].any()
        assert 0 < mask.mean() < 0.5
    assert "exists already" in error_of(capsys, *line, "--query", "red mug", "--output", room / "capture/masks")
    assert "no match, so no mask" in error_of(capsys, *line, "--query", "elephant", "--output", room / "none")


def test_an_object_has_its_number_in_all_photos(room):
    scene = opened(room)
    write_masks(room / "masks", scene)
    names = json.loads((room / "masks" / NAMES).read_text())
    assert list(names) == ["1", "2"]
    for view in scene.views:
        shown = numbers(room / "masks", view)
        for number, thing in enumerate(scene.objects, 1):
            x, y, z = view.K @ (view.cam_from_world[:3, :3] @ thing.center + view.cam_from_world[:3, 3])
            assert shown[int(y / z), int(x / z)] == number
        assert shown[0, 0] == 0


def test_masks_lie_on_the_photo_as_its_lens_bends_it(room):
    plain = opened(room)
    bent = Scene(plain.field, plain.gaussians, [replace(view, distortion=LENS) for view in plain.views])
    write_masks(room / "plain", plain)
    write_masks(room / "bent", bent)
    for view in bent.views:
        shown, stored = numbers(room / "plain", view).astype(np.int32), numbers(room / "bent", view).astype(np.int32)
        assert (shown != stored).any()
        back = undistort_ids(view, stored)
        assert (back == shown)[back >= 0].mean() > 0.98


def test_a_scene_without_photos_or_objects_says_so(room):
    scene = opened(room)
    with refused("has no views"):
        write_masks(room / "masks", Scene(scene.field, scene.gaussians))
    with refused("objects"):
        write_masks(room / "masks", Scene(scene.field.with_objects(None), scene.gaussians, scene.views))
    assert not (room / "masks").exists()


def test_photos_larger_than_what_is_drawn_get_masks_of_their_size(room, monkeypatch):
    scene = opened(room)
    write_masks(room / "fine", scene)
    monkeypatch.setattr("drsplat.authoring.exporting.masking.DRAWN_SIDE_PIXELS", 32)
    write_masks(room / "coarse", scene)
    for view in scene.views:
        fine, coarse = numbers(room / "fine", view), numbers(room / "coarse", view)
        assert fine.shape == coarse.shape == (view.height, view.width)
        assert (fine == coarse).mean() > 0.9
    assert_array_equal(np.unique(coarse), np.unique(fine))
