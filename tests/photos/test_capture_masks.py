"""Masks beside photos: what they leave out has no part in poses."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from test_capture import differences, has_colmap

from drsplat.errors import MismatchError
from drsplat.formats.captures import read_views
from drsplat.photos.capture.capturing import capture
from drsplat.photos.capture.finding import find_photos
from drsplat.photos.capture.photos import bring, bring_mask
from drsplat.photos.capture.settings import CaptureSettings
from drsplat.scene.photo_masks import load_mask
from drsplat.scene.photos import load_image
from photographed_room import HEIGHT, WIDTH, exif_of, jpeg, photographed, room_views
from refusing import malformed, refused

GRIPPER_ROWS = slice(HEIGHT // 2, HEIGHT)  # which moves with the camera
CORNER = np.pad(np.full((10, 10), 255, np.uint8), ((0, 50), (0, 70)))  # white at the upper left of 80 x 60


def with_gripper(pixels: np.ndarray) -> np.ndarray:
    blots = np.random.default_rng(3).integers(0, 255, (HEIGHT // 8, WIDTH // 4, 3), np.uint8)
    held = Image.fromarray(blots).resize((WIDTH, HEIGHT // 2), Image.Resampling.BICUBIC)
    result = pixels.copy()
    result[GRIPPER_ROWS] = np.asarray(held)
    return result


@pytest.mark.slow
@has_colmap
def test_what_a_robot_holds_before_its_camera_is_left_out(tmp_path):
    views = room_views(8)
    (tmp_path / "photos/masks").mkdir(parents=True)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[GRIPPER_ROWS] = 255  # white is left out: --invert-masks
    for k, view in enumerate(views):
        seen = photographed(view) if k == 4 else with_gripper(photographed(view))
        (tmp_path / "photos" / view.name).write_bytes(jpeg(seen, exif_of(view)))
        if k == 4:
            continue  # which has no mask, and loses no features
        stem = view.name if k % 2 else view.name.removesuffix(".jpg")
        Image.fromarray(mask).save(tmp_path / "photos/masks" / f"{stem}.png")
    settings = CaptureSettings(invert_masks=True)
    record = capture(tmp_path / "photos", tmp_path / "capture", settings, threads=2)
    assert record["num_registered"] == len(views)
    away, turned, _ = differences(read_views(tmp_path / "capture"), views)
    assert away < 0.01
    assert turned < 0.5
    with Image.open(tmp_path / "capture/masks/photo_03.jpg.png") as kept:
        assert np.array_equal(np.asarray(kept), 255 - mask)
    with refused("too little movement"):  # of what is held alone
        capture(tmp_path / "photos", tmp_path / "other", CaptureSettings(), threads=2)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("upright", [False, True])
def test_masks_are_turned_with_their_photos(orientation, upright, tmp_path):
    """A mask of the photo as stored is turned with it. One that is upright already is told by its shape alone."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    photo = np.repeat(CORNER[..., None], 3, axis=2)
    larger = Image.fromarray(photo).resize((160, 120))
    larger.save(tmp_path / "a.png", exif=exif)
    source = find_photos(tmp_path)[0]
    brought = bring(source, tmp_path)
    with Image.open(tmp_path / brought.file) as picture:
        expected = np.asarray(picture.convert("L").resize((brought.width // 2, brought.height // 2)))
    if upright and orientation > 4:
        mask = Image.fromarray(expected)
    elif upright:
        return
    else:
        mask = Image.fromarray(CORNER)
    mask.save(tmp_path / "mask.png")
    bring_mask(tmp_path / "mask.png", tmp_path / "out.png", (brought.width, brought.height), orientation, False)
    with Image.open(tmp_path / "out.png") as kept:
        assert kept.size == (brought.width, brought.height)
        assert np.array_equal(np.asarray(kept.resize((brought.width // 2, brought.height // 2))) > 127, expected > 127)


def test_masks_that_fit_no_photo_are_errors(tmp_path):
    (tmp_path / "masks").mkdir()
    Image.fromarray(CORNER).resize((160, 120)).save(tmp_path / "a.jpg")
    with refused("no mask in it has a photo's name"):
        find_photos(tmp_path)
    with pytest.raises(MismatchError, match="the mask is 160x120, its photo 80x80"):
        bring_mask(tmp_path / "a.jpg", tmp_path / "b.png", (80, 80), 1, False)
    (tmp_path / "masks/a.png").write_text("no mask")
    with malformed("cannot be read as a mask"):
        bring(find_photos(tmp_path)[0], tmp_path)


def test_a_photo_whose_mask_is_black_is_left_out_with_a_reason(tmp_path):
    Image.fromarray(CORNER).resize((160, 120)).save(tmp_path / "a.jpg")
    (tmp_path / "masks").mkdir()
    Image.fromarray(np.full((120, 160), 255, np.uint8)).save(tmp_path / "masks/a.png")
    (tmp_path / "work/photos").mkdir(parents=True)
    (tmp_path / "work/masks").mkdir()
    source, folder = find_photos(tmp_path)[0], tmp_path / "work/photos"
    assert bring(source, folder).fault is None
    assert "its mask leaves all of it out: white is kept" in (bring(source, folder, invert_masks=True).fault or "")
    assert len(list(folder.iterdir())) == 1


@pytest.mark.slow
@has_colmap
def test_masks_of_fisheyes_are_undistorted_with_their_photos(tmp_path):
    """Photos are painted white where their masks leave them out: in the capture both still agree."""
    wide = np.array([[180.0, 0, WIDTH / 2], [0, 180.0, HEIGHT / 2], [0, 0, 1]])
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[100:200, 60:150] = 255
    (tmp_path / "photos/masks").mkdir(parents=True)
    for view in room_views(10):
        pixels = photographed(replace(view, K=wide), fisheye=True)
        pixels[mask == 255] = 255
        (tmp_path / "photos" / view.name).write_bytes(jpeg(pixels))
        Image.fromarray(mask).save(tmp_path / "photos/masks" / f"{view.name}.png")
    capture(tmp_path / "photos", tmp_path / "c", CaptureSettings(lens="fisheye", invert_masks=True), threads=2)
    views = read_views(tmp_path / "c")
    assert len(views) > 5
    for view in views:
        kept, pixels = load_mask(view), load_image(view)
        assert kept.shape == pixels.shape[:2]
        white = (pixels > 240).all(axis=2)
        assert white.mean() > 0.02
        assert (white == kept).mean() < 0.01  # of the border of what is painted


def test_masks_lie_beside_a_folder_of_images(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "masks").mkdir()
    Image.fromarray(CORNER).save(tmp_path / "images/a.jpg")
    Image.fromarray(CORNER).save(tmp_path / "masks/a.jpg.png")
    assert find_photos(tmp_path / "images")[0].mask == tmp_path / "masks/a.jpg.png"
