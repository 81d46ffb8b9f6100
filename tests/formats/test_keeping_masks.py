"""Another encoder on the masks that a folder has."""

from pathlib import Path

import numpy as np
import pytest

import drsplat as ds
from command_line import answer_of, error_of
from drsplat.errors import DrSplatWarning, InputError, MismatchError
from drsplat.formats.langsplat import write_features
from drsplat.scene.encoders import EncoderIdentity
from growing_fields import files_of
from toy_capture import write_toy_capture


class Colours:
    """Mean colour and share of the crop that is covered: tells crops apart."""

    identity = EncoderIdentity("colours", 4)

    def encode_images(self, images: list[np.ndarray]) -> np.ndarray:
        rows = np.array([[*image.reshape(-1, 3).mean(0), 255 * image.any(axis=2).mean()] for image in images])
        return np.float32(rows / np.linalg.norm(rows, axis=1, keepdims=True))


@pytest.fixture
def room(tmp_path) -> Path:
    return write_toy_capture(tmp_path)


def test_masks_and_ids_stay_and_embeddings_are_of_their_crops(room):
    views, old = ds.read_views(room / "capture"), ds.read_features(room / "capture/language_features")
    report = ds.embed(views, room / "new", old, Colours())
    assert (report.photos, report.reused) == (4, 0)
    new = ds.read_features(room / "new")
    for view in views:
        (ids, before), (again, rows) = old.stored(view.name), new.stored(view.name)
        np.testing.assert_array_equal(ids, again)
        assert rows.shape == (len(before), 4)
        picture = ds.load_image(view)
        for number in range(len(rows)):
            inside = ids[3] == number
            y, x = (slice(part.min(), part.max() + 1) for part in np.nonzero(inside))
            mean = (picture[y, x] * inside[y, x, None]).reshape(-1, 3).mean(0)
            np.testing.assert_allclose(rows[number, :3] / rows[number, :3].sum(), mean / mean.sum(), atol=1e-5)
    assert ds.embed(views, room / "new", old, Colours()).reused == 4
    ids, rows = old.stored("photo_2")
    write_features(old.directory, "photo_2", np.roll(ids, 2, axis=2), rows, overwrite=True)
    assert ds.embed(views, room / "new", old, Colours()).reused == 3


def test_the_same_encoder_gives_the_same_files(room, capsys):
    """Masks of `graph` do not overlap, so that maps hold them whole."""
    argv = ["embed", room / "capture", "--encoder", "drsplat-mini", "--output"]
    answer_of(capsys, *argv, room / "one", "--segmenter", "graph")
    told = answer_of(capsys, *argv, room / "two", "--masks", room / "one")
    assert told["num_photos"] == 4
    for name in ds.read_features(room / "one"):
        name = f"{name}.features.safetensors"
        assert (room / "one" / name).read_bytes() == (room / "two" / name).read_bytes()
    assert "drop --segmenter" in error_of(
        capsys, *argv, room / "three", "--masks", room / "one", "--segmenter", "graph"
    )
    assert "with --output" in error_of(capsys, *argv[:-1], "--masks", room / "one")


def test_an_encoder_is_swapped_without_cutting_or_registering_a_photo(room, capsys):
    features, scene, capture = room / "capture/language_features", room / "scene.ply", room / "capture"
    register = ["register", scene, capture, "--features"]
    answer_of(capsys, *register, features, "--output", room / "a.field")
    ds.embed(ds.read_views(capture), room / "new", ds.read_features(features), Colours())
    code = ["--code", "mixture"]
    answer_of(capsys, *register, room / "new", *code, "--output", room / "b.field", "--weights-of", room / "a.field")
    answer_of(capsys, *register, room / "new", *code, "--output", room / "c.field")
    assert files_of(room / "b.field") == files_of(room / "c.field")
    assert ds.load_field(room / "b.field").encoder.name == "colours"


def test_masks_of_other_photos_are_refused(room):
    views = ds.read_views(room / "capture")
    other = room / "other"
    write_features(other, "photo_0", np.zeros((50, 50), np.int32), np.ones((1, 3), np.float32))
    with pytest.raises(MismatchError, match="are 50x50, its photo 96x72"):
        ds.embed(views[:1], room / "new", ds.read_features(other), Colours())
    with pytest.raises(InputError, match="no photo has masks there: photos are named like 'photo_1'"):
        ds.embed(views[1:], room / "new", ds.read_features(other), Colours())
    write_features(other, "photo_0", np.zeros((72, 96), np.int32), np.ones((1, 3), np.float32), overwrite=True)
    with pytest.warns(DrSplatWarning, match=r"3 of 4 photos have no masks"):
        ds.embed(views, room / "some", ds.read_features(other), Colours())
