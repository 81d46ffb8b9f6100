"""Damaged and hostile annotations: masks of the photo's size or a precise error."""

import json

import numpy as np
import pytest
from test_views_hostile import bounded_memory, memory_path, survive  # noqa: F401

from drsplat.errors import FormatError
from drsplat.formats.lvis import Annotations, decode_runs, fill_polygon, read_annotations, unpack_counts
from lvis_files import document
from mutations import quota, seeded
from refusing import malformed

DECODED_PIXELS = 1 << 20  # masks of larger photos are only made beside a photo of that size


def check(annotations: Annotations) -> None:
    for photo in annotations.photos.values():
        assert 1 <= min(photo.height, photo.width) <= max(photo.height, photo.width) <= 1 << 16
        assert ".." not in photo.name.split("/")
        assert not photo.name.startswith("/")
    for instance in annotations.instances:
        photo = annotations.photos[instance.photo]
        assert instance.category in annotations.categories
        assert np.isfinite(instance.area)
        if photo.height * photo.width <= DECODED_PIXELS:
            assert annotations.mask(instance).shape == (photo.height, photo.width)


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1, 2], ids=["polygon", "runs", "text"])
def test_annotations(memory_path, bounded_memory, first):  # noqa: F811
    """Those of one kind each: mutations of text go to the first 4 KiB."""
    content = document()
    content["annotations"] = content["annotations"][first::3][:2]
    path = memory_path / "annotations.json"
    path.write_text(json.dumps(content))
    survive([path], lambda: check(read_annotations(path)), quota(1500))


def test_text_of_runs(bounded_memory):  # noqa: F811
    """Any text is numbers or refused; numbers are a mask or refused."""
    rng = seeded(0)
    sound = 0
    for _ in range(quota(3000)):
        text = "".join(map(chr, rng.integers(47, 113, rng.integers(0, 40))))
        try:
            counts = unpack_counts(text, "here")
            sound += 1
            assert decode_runs(counts, 30, 40, "here").shape == (30, 40)
        except FormatError:
            pass
    assert sound > 100


@pytest.mark.slow
@pytest.mark.parametrize(
    "counts",
    [
        [2**62, 2**62, 2**62, 2**62, 1200],  # adds up to 1200 in 64 bits
        [-(2**63), 1200],
        [2**63 - 1],
        [1200] * 1000,
    ],
)
def test_counts_are_not_believed(bounded_memory, counts):  # noqa: F811
    with malformed("here"):
        decode_runs(np.array(counts, np.int64), 30, 40, "here")


def test_images_without_end_take_no_memory(bounded_memory):  # noqa: F811
    """Runs that do not add up are refused before the image is allocated."""
    with malformed("add up to 3 pixels"):
        decode_runs(np.int64([1, 2]), 60_000, 60_000, "here")


def test_polygons_of_many_corners_take_little_memory(bounded_memory):  # noqa: F811
    """A zigzag over the whole height: 4 million crossings with rows."""
    y = np.where(np.arange(4000) % 2, 1000.0, 0.0)
    x = np.sort(np.random.default_rng(0).uniform(0, 1000, 4000))
    points = np.stack([x, y], 1)
    assert 0.2 < fill_polygon(points, 1000, 1000).mean() < 0.6


def test_path_tricks(tmp_path):
    for key, name in (("file_name", "../../secret.png"), ("coco_url", "http://host/a/..\\secret")):
        content = document()
        content["images"][0][key] = name
        (tmp_path / "a.json").write_text(json.dumps(content))
        with malformed(f"image 11: {key}"):
            read_annotations(tmp_path / "a.json")
