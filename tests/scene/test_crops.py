"""Crops of masks: bit-equal to a reference that is written out pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from drsplat.scene.masks.crops import Crops, crop, crops
from drsplat.scene.masks.masks import Masks
from refusing import refused

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(1, 256, (7, 9, 3), np.uint8)


def by_hand(image: np.ndarray, part: np.ndarray, box: tuple[int, ...]) -> np.ndarray:
    """One pixel at a time, as LangSplat's rule says."""
    x0, y0, x1, y1 = box
    width, height = x1 - x0, y1 - y0
    side = max(width, height)
    left = (side - width) // 2 if height > width else 0
    top = 0 if height > width else (side - height) // 2
    square = [[[0, 0, 0] for _ in range(side)] for _ in range(side)]
    for y in range(height):
        for x in range(width):
            if part[y, x]:
                square[top + y][left + x] = [int(value) for value in image[y0 + y, x0 + x]]
    return np.array(square, np.uint8)


@settings(derandomize=True, max_examples=80)
@given(st.data())
def test_any_crop_is_that_of_the_reference(data):
    height, width = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 9))
    x0, y0 = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    x1, y1 = data.draw(st.integers(x0 + 1, width)), data.draw(st.integers(y0 + 1, height))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    image = rng.integers(0, 256, (height, width, 3), np.uint8)
    part = rng.random((y1 - y0, x1 - x0)) < 0.5
    part[-1, -1] = True
    box = np.int32([x0, y0, x1, y1])
    assert_array_equal(crop(image, part, box), by_hand(image, part, (x0, y0, x1, y1)))


def test_the_image_is_left_alone():
    before = IMAGE.copy()
    crop(IMAGE, np.ones((7, 9), bool), (0, 0, 9, 7))[:] = 0
    assert_array_equal(IMAGE, before)


@pytest.mark.parametrize("box", [(-1, 0, 2, 3), (7, 0, 10, 3), (0, 5, 3, 8), (0, 0, 3, 4)])
def test_boxes_that_do_not_fit(box):
    with refused("in an image of 9x7"):
        crop(IMAGE, np.ones((3, 3), bool), box)


def test_an_empty_mask_has_no_crop():
    with refused("no pixel"):
        crop(IMAGE, np.zeros((3, 3), bool), (0, 0, 3, 3))


def masks_of(boxes: list[tuple[int, int, int, int]], empty: set[int]) -> Masks:
    parts = [np.full((y1 - y0, x1 - x0), row not in empty) for row, (x0, y0, x1, y1) in enumerate(boxes)]
    scores = np.ones(len(boxes), np.float32)
    return Masks(7, 9, np.array(boxes, np.int32).reshape(-1, 4), tuple(parts), scores)


def test_empty_masks_are_left_out_and_counted():
    boxes = [(0, 0, 2, 2), (1, 1, 4, 3), (2, 2, 9, 7), (0, 0, 1, 1)]
    found = crops(IMAGE, masks_of(boxes, {1, 3}))
    assert isinstance(found, Crops)
    assert (len(found), found.num_empty) == (2, 2)
    assert_array_equal(found.kept, [0, 2])
    for picture, row in zip(found, found.kept, strict=True):
        assert_array_equal(picture, by_hand(IMAGE, np.ones((7, 9), bool), boxes[row]))
    assert [c.shape[0] for c in found[:]] == [2, 7]
    assert_array_equal(found[-1], found[1])
    with pytest.raises(IndexError):
        found[2]


def test_no_masks_no_crops():
    found = crops(IMAGE, masks_of([], set()))
    assert (list(found), found.num_empty, found.kept.shape) == ([], 0, (0,))


def test_masks_of_another_image():
    with refused("9x7 pixels, given with one of 8x7"):
        crops(IMAGE[:, :8], masks_of([], set()))
