"""Masks cut to boxes, which of them stay, and the maps they become."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.formats.langsplat import read_features, write_features
from drsplat.scene.masks.masks import LEVELS, Masks, cut_masks
from drsplat.scene.masks.selection import mask_maps, mask_nms, overlaps, paint
from refusing import refused


def of(*drawings: str, scores: list[float] | None = None) -> Masks:
    """Masks from rows of '#' and '.', rows separated by '/'."""
    full = np.array([[[c == "#" for c in row] for row in d.split("/")] for d in drawings])
    return cut_masks(full, np.array(scores or [0.9] * len(full), np.float32))


@st.composite
def many_masks(draw):
    """Rectangles, their parts, copies and noise, on images from 1x1 to 9x14."""
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 14))
    full = []
    for _ in range(draw(st.integers(0, 7))):
        kind = draw(st.sampled_from(["box", "noise", "copy", "part", "empty"]))
        mask = np.zeros((height, width), bool)
        if kind == "box":
            y, x = draw(st.integers(0, height - 1)), draw(st.integers(0, width - 1))
            mask[y : draw(st.integers(y, height)) + 1, x : draw(st.integers(x, width)) + 1] = True
        elif kind == "noise":
            mask = draw(arrays(bool, (height, width)))
        elif kind != "empty" and full:
            mask = full[-1].copy()
            if kind == "part":
                mask &= np.arange(width) <= draw(st.integers(0, width))
        full.append(mask)
    scores = draw(st.lists(st.sampled_from([0.3, 0.7, 0.71, 0.9]), min_size=len(full), max_size=len(full)))
    stacked = np.array(full, bool).reshape(-1, height, width)
    return stacked, np.array(scores, np.float32)


def nms_one_pair_at_a_time(full, scores, max_iou=0.8, min_score=0.7, inner=0.5) -> list[int]:
    """The rule as the published code states it, on whole images, after sorting by score."""
    order = sorted(range(len(full)), key=lambda i: -scores[i])
    gone = set()
    for a, i in enumerate(order):
        if not full[i].any() or not scores[i] > np.float32(min_score):
            gone.add(i)
        for j in order[a + 1 :]:
            if not full[i].any() or not full[j].any():
                continue
            shared = int((full[i] & full[j]).sum())
            if shared / int((full[i] | full[j]).sum()) > max_iou:
                gone.add(j)
            of_i, of_j = shared / int(full[i].sum()), shared / int(full[j].sum())
            if of_i < 0.5 and of_j >= 0.85 and 1 - of_j * of_i > 1 - inner:
                gone.add(j)
            if of_i >= 0.85 and of_j < 0.5 and 1 - of_j * of_i > 1 - inner:
                gone.add(i)
    return [i for i in range(len(full)) if i not in gone]


# --- masks in boxes -------------------------------------------------------------------------------


@given(many_masks())
def test_cut_masks_are_the_full_ones_again(drawn):
    full, scores = drawn
    masks = cut_masks(full, scores)
    assert len(masks) == len(full)
    assert_array_equal(masks.areas, full.sum((1, 2)))
    for i, mask in enumerate(full):
        assert_array_equal(masks.full(i), mask)
        if mask.any():  # the box is tight
            part = masks.parts[i]
            assert part[0].any()
            assert part[-1].any()
            assert part[:, 0].any()
            assert part[:, -1].any()


def test_a_subset_has_its_own_order():
    masks = of("#.", ".#", "##", scores=[0.1, 0.2, 0.3])
    some = masks.subset([2, 0])
    assert_array_equal(some.boxes, [[0, 0, 2, 1], [0, 0, 1, 1]])
    assert_allclose(some.scores, [0.3, 0.1])
    assert len(masks.subset([])) == 0


def test_images_without_pixels_are_refused():
    with refused("at least 1x1"):
        cut_masks(np.zeros((2, 0, 3), bool), np.ones(2, np.float32))


# --- which stay -----------------------------------------------------------------------------------


@given(many_masks())
def test_overlaps_are_those_of_whole_images(drawn):
    full, scores = drawn
    flat = full.reshape(len(full), full.shape[1] * full.shape[2]).astype(np.int64)
    assert_array_equal(overlaps(cut_masks(full, scores)), flat @ flat.T)


@settings(max_examples=300)
@given(many_masks(), st.sampled_from([0.2, 0.5, 0.8]), st.sampled_from([0.1, 0.3, 0.5]))
def test_what_stays_is_what_a_plain_loop_keeps(drawn, max_iou, inner):
    full, scores = drawn
    kept = mask_nms(cut_masks(full, scores), max_iou, inner=inner)
    assert kept.tolist() == nms_one_pair_at_a_time(full, scores, max_iou, inner=inner)


def test_the_bounds_themselves_are_in():
    at_bound = of("####.", "#####", scores=[0.9, 0.8])  # IoU 4/5 is not above 0.8
    assert mask_nms(at_bound).tolist() == [0, 1]
    above = of("#########.", "##########", scores=[0.9, 0.8])
    assert mask_nms(above).tolist() == [0]
    assert mask_nms(of("#", scores=[0.7])).tolist() == []  # not above 0.7
    assert mask_nms(of("##", "##")).tolist() == [0]  # of equal ones the first


def test_no_masks_at_all():
    none = cut_masks(np.zeros((0, 4, 5), bool), np.empty(0, np.float32))
    assert mask_nms(none).tolist() == []
    assert (paint(none) == -1).all()


# --- maps -----------------------------------------------------------------------------------------


@given(many_masks())
def test_a_painted_pixel_has_the_last_mask_on_it(drawn):
    full, scores = drawn
    ids = paint(cut_masks(full, scores))
    for y, x in np.ndindex(ids.shape):
        assert ids[y, x] == max(np.flatnonzero(full[:, y, x]), default=-1)


def test_ids_count_on_from_level_to_level():
    levels = {
        "small": of("##.", "..#"), "default": of("#..", ".#."), "large": of("###"),
        "medium": of("#..", "##."),
    }  # fmt: skip
    maps = mask_maps(levels)
    expected = [[[0, 1, -1]], [[2, 2, 3]], [[4, 4, -1]], [[5, 5, 5]]]  # medium's first is hidden
    assert_array_equal(maps.mask_ids, expected)
    assert_array_equal(maps.masks.areas, [1, 1, 2, 1, 2, 3])


def test_large_masks_alone_serve_as_all_levels(tmp_path):
    maps = mask_maps({"large": of("#.../....", "##../....", "...#/...#")})
    assert len(maps.masks) == 2
    for level in maps.mask_ids:
        assert_array_equal(level, [[0, 0, -1, 1], [-1, -1, -1, 1]])
    write_features(tmp_path, "a", maps.mask_ids, np.eye(2, dtype=np.float32))
    for level in LEVELS:
        assert read_features(tmp_path, level)["a"].file_rows.tolist() == [0, 1]


@given(st.data())
def test_every_row_has_a_pixel_and_every_pixel_its_mask(data):
    full, scores = data.draw(many_masks())
    shuffled = {level: data.draw(st.permutations(range(len(full)))) for level in LEVELS}
    levels = {name: cut_masks(full[order], scores[order]) for name, order in shuffled.items()}
    maps = mask_maps(levels)
    assert maps.mask_ids.dtype == np.int32
    used = np.unique(maps.mask_ids)
    assert_array_equal(used[used >= 0], np.arange(len(maps.masks)))
    for level, ids in zip(LEVELS, maps.mask_ids, strict=True):
        painted = paint(levels[level])
        assert_array_equal(ids < 0, painted < 0)
        for i in np.unique(ids[ids >= 0]):
            (old,) = np.unique(painted[ids == i])
            assert_array_equal(maps.masks.full(int(i)), levels[level].full(int(old)))


@pytest.mark.parametrize("names", [(), ("small",), ("default", "large"), ("large", "huge")])
def test_other_levels_are_refused(names):
    with refused("expected default, small, medium, large or large alone"):
        mask_maps({name: of("#") for name in names})


def test_levels_of_two_images_are_refused():
    with refused("masks of one image"):
        mask_maps({name: of("#" if name == "small" else "##") for name in LEVELS})
