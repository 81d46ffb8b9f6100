"""LERF-OVS labels: polygons as OpenCV fills them, and files that are damaged."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from drsplat.formats.lerf_ovs import fill_polygon, read_lerf_frame, read_lerf_labels
from mutations import quota, seeded, survivors
from refusing import malformed, refused

few = settings(derandomize=True, max_examples=60)
MUTANTS = quota(3_000)
RECORD = {
    "info": {"name": "frame_00041.jpg", "width": 40, "height": 30},
    "objects": [
        {"category": "red mug", "bbox": [2, 2, 6, 5], "segmentation": [[2, 2], [6, 2], [6, 5], [2, 5]]},
        {"category": "red mug", "bbox": [20, 20, 24, 22], "segmentation": [[20, 20], [24, 20], [24, 22]]},
        {"category": "plate", "bbox": [30, 1, 39, 9], "segmentation": [[30.7, 1.2], [39, 1], [39, 9]]},
    ],
}  # fmt: skip


def drawn(rows: list[str]) -> np.ndarray:
    return np.array([[letter == "#" for letter in row] for row in rows])


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ([[1, 0], [3, 0], [3, 2], [1, 2]], [".###.", ".###.", ".###."]),
        ([[0, 0], [4, 0], [0, 2]], ["#####", "####.", "##..."]),
        ([[0, 0], [4, 2], [2, 1]], ["##...", "..##.", "....#"]),  # an edge alone
        ([[2, 1], [2, 1], [2, 1]], [".....", "..#..", "....."]),
        ([[-3, -2], [9, -2], [9, 9], [-3, 9]], ["#####", "#####", "#####"]),
        ([[0, 0], [4, 0], [0, 2], [4, 2]], ["#####", "..##.", "#####"]),  # crosses itself
    ],
)
def test_fill_by_hand(corners, expected):
    assert_array_equal(fill_polygon(np.array(corners), 5, 3), drawn(expected))


points = st.lists(st.tuples(st.integers(-5, 45), st.integers(-5, 35)), min_size=3, max_size=8)


@few
@given(points)
def test_fill_holds_what_is_inside_and_little_else(corners):
    """Every pixel whose centre is inside is filled; every filled one is within a pixel of it."""
    filled = fill_polygon(np.array(corners), 40, 30)
    y, x = np.mgrid[:30, :40]
    inside = even_odd(np.array(corners, float), x.ravel() + 1e-7, y.ravel() + 1e-7)
    assert not (inside.reshape(30, 40) & ~filled).any()
    assert (distance_to_edges(np.array(corners), x, y)[filled & ~inside.reshape(30, 40)] <= 1).all()


def even_odd(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    inside = np.zeros(len(x), bool)
    for (x1, y1), (x2, y2) in zip(corners, np.roll(corners, -1, 0), strict=True):
        if y1 != y2:
            inside ^= ((y1 > y) != (y2 > y)) & (x < x1 + (y - y1) * (x2 - x1) / (y2 - y1))
    return inside


def distance_to_edges(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    best = np.full(x.shape, np.inf)
    for start, end in zip(corners, np.roll(corners, -1, 0), strict=True):
        along = end - start
        t = ((x - start[0]) * along[0] + (y - start[1]) * along[1]) / max(along @ along, 1)
        t = np.clip(t, 0, 1)
        best = np.minimum(best, np.hypot(x - start[0] - t * along[0], y - start[1] - t * along[1]))
    return best


@few
@given(points, st.integers(0, 7))
def test_fill_does_not_depend_on_where_the_polygon_begins(corners, shift):
    turned = np.roll(np.array(corners), shift, axis=0)
    assert_array_equal(fill_polygon(np.array(corners), 40, 30), fill_polygon(turned[::-1], 40, 30))


def written(folder: Path, record: object = RECORD) -> Path:
    path = folder / "frame_00041.json"
    path.write_text(json.dumps(record))
    return path


def test_objects_of_a_category_are_one_mask(tmp_path):
    frame = read_lerf_frame(written(tmp_path))
    assert frame.categories == ("plate", "red mug")
    mask = frame.mask("red mug")
    assert mask.shape == (30, 40)
    assert mask[2:6, 2:7].all()
    assert mask[20, 20:25].all()
    assert mask.sum() == 4 * 5 + 5 + 3 + 1  # rectangle; triangle with its edges
    assert_array_equal(frame.polygons["plate"][0], [[30, 1], [39, 1], [39, 9]])  # cut, not rounded
    assert_array_equal(frame.boxes["red mug"], [[2, 2, 6, 5], [20, 20, 24, 22]])


def test_frames_are_sorted_and_a_folder_without_any_is_an_error(tmp_path):
    written(tmp_path)
    (tmp_path / "frame_00002.json").write_text('{"info":{"width":4,"height":3},"objects":[]}')
    assert [f.name for f in read_lerf_labels(tmp_path)] == ["frame_00002", "frame_00041"]
    with refused("frame_XXXXX"):
        read_lerf_labels(tmp_path / "none")


def changed(**fields: object) -> dict[str, object]:
    objects = [dict(entry) for entry in RECORD["objects"]]
    objects[1] |= fields
    return {**RECORD, "objects": objects}


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ([], 'an object with info, objects'),
        ({**RECORD, "info": {"width": 0, "height": 3}}, "info.width: expected 1 to"),
        ({**RECORD, "info": {"width": 4, "height": 10**9}}, "info.height: expected 1 to"),
        ({**RECORD, "info": {"width": 4, "height": 3, "name": "frame_1.jpg"}}, "expected 'frame_00041'"),
        ({**RECORD, "objects": {}}, "objects: expected a list"),
        ({**RECORD, "objects": [3]}, "object 0: expected an object"),
        (changed(category=""), "object 1: category"),
        (changed(category=None), "object 1: category"),
        (changed(segmentation=[[1, 2], [3, 4]]), r"object 1 \('red mug'\): segmentation: .* corners"),
        (changed(segmentation=[[1, 2], [3, 4], [5]]), "object 1 .*: segmentation: expected 2 numbers"),
        (changed(segmentation=[[1, 2], [3, 4], [5, None]]), "object 1 .*: segmentation: .* number"),
        (changed(segmentation=[[1, 2], [3, 4], [1e9, 2]]), "object 1 .*: segmentation: .* outside"),
        (changed(bbox=[1, 2, 3]), "object 1 .*: bbox: expected 4 numbers"),
    ],
)  # fmt: skip
def test_labels_that_are_wrong_are_named(record, message, tmp_path):
    with malformed(message) as error:
        read_lerf_frame(written(tmp_path, record))
    assert "frame_00041.json" in str(error.value)


@pytest.mark.slow
def test_damaged_labels(tmp_path, bounded_memory):
    def read(path):
        frame = read_lerf_frame(path)
        if frame.width * frame.height < 1 << 20:
            for category in frame.categories:
                frame.mask(category)

    assert 0 < survivors(written(tmp_path), read, seeded(0), MUTANTS) < MUTANTS / 2
