"""The study of objects (benchmarks/study_objects.py): its numbers by hand, and its rivals on masks that are known."""

import numpy as np
import pytest
from benchmarks.study_objects import Room, regions_of, with_wrong
from benchmarks.suite.instances import Compared, Region, average_precision, compare, numbers, panoptic_quality
from benchmarks.suite.rivals.things import Agreement, Alike, dominant, in_space, light_splat, mask_clustering, sureness
from scipy.sparse import csr_array

from drsplat.field.evidence.evidence import Evidence, MaskIds

EACH = 100
OWNERS = np.repeat([0, 1, 7, -1], EACH)  # two things, a structure, what no photo shows
THINGS = [0, 1]
CATEGORIES = {0: "mug", 1: "book"}


def region(begin: int, end: int, score: float) -> Region:
    return Region(np.arange(begin, end), score)


FIRST, SECOND, STRUCTURE = region(0, 100, 0.9), region(100, 200, 0.8), region(200, 300, 1.0)


def compared(*regions: Region) -> Compared:
    return compare(regions, OWNERS, THINGS)


def test_all_is_one_where_all_is_found_and_nothing_where_nothing_is():
    assert set(numbers(compared(SECOND, FIRST)).values()) == {1.0}
    assert set(numbers(compared()).values()) == {0.0}


@pytest.mark.parametrize(
    ("regions", "precision", "quality"),
    [
        ((FIRST,), 0.5, 1 / 1.5),
        ((FIRST, SECOND, STRUCTURE), 1.0, 1.0),  # mostly void: neither right nor wrong
        ((FIRST, SECOND, region(0, 50, 0.95)), 1.0, 1.0),  # below 60 Gaussians
        ((FIRST, region(100, 160, 0.5)), 0.5 + 0.5, (1 + 0.6) / 2),
        ((region(160, 240, 0.95), FIRST), 0.125, 1 / 2),  # half of it is no more than half: wrong, and surest
        ((FIRST, region(0, 90, 0.7)), 0.5, 1 / 2),  # the same again: wrong
        ((FIRST, region(0, 90, 0.7), region(100, 200, 0.6)), 0.5 + 0.5 * (1 / 2 + 2 / 3) / 2, 2 / 2.5),
        ((region(0, 100, 0.9), region(150, 240, 0.9)), 0.5 * (1 + 1 / 2) / 2, 1 / 2),  # of equal scores, all or none
    ],
)
def test_by_hand(regions, precision, quality):
    assert average_precision(compared(*regions), 0.5) == pytest.approx(precision)
    assert panoptic_quality(compared(*regions)) == pytest.approx(quality)


def test_levels_are_strict_and_a_small_thing_is_void():
    half = compared(region(0, 80, 0.5), region(100, 150, 0.9))
    assert half.best.tolist() == [0.8, 0.5]
    assert average_precision(half, 0.8) == 0.0
    assert numbers(half)["AP"] == pytest.approx(0.5 * 6 / 10)
    owners = np.repeat([0, 1], [100, 59])
    assert compared(region(0, 55, 0.5)).best.tolist() == [0.55, 0.0]  # found, though too small a prediction
    few = compare([region(0, 100, 0.5), region(98, 159, 0.9)], owners, THINGS)
    assert few.sizes.tolist() == [100]
    assert average_precision(few, 0.5) == 1.0


def evidence(*views: list[int]) -> Evidence:
    """Three boxes of 100 Gaussians; of each view, the mask that each box lies in."""
    columns, starts = [], np.cumsum([0, *(max(masks) + 1 for masks in views)])
    for begin, masks in zip(starts, views, strict=False):
        columns.append(np.repeat(masks, EACH) + begin)
    rows = np.tile(np.arange(3 * EACH), len(views))
    count = int(starts[-1])
    weights = csr_array((np.ones(len(rows), np.float32), (rows, np.concatenate(columns))), shape=(3 * EACH, count))
    of_view = np.repeat(np.arange(len(views)), np.diff(starts)).astype(np.int32)
    names = tuple(f"{number}.jpg" for number in range(len(views)))
    ids = MaskIds(names, of_view, np.arange(count, dtype=np.int32))
    return Evidence(weights, ids, np.ones((count, 1), np.float32))


def boxes() -> np.ndarray:
    rng = np.random.default_rng(0)
    return (rng.random((3 * EACH, 3)) + np.repeat([[0, 0, 0], [5, 0, 0], [10, 0, 0]], EACH, 0)).astype(np.float32)


def parts(labels: np.ndarray) -> list[set[int]]:
    return [set(labels[at : at + EACH].tolist()) for at in range(0, 3 * EACH, EACH)]


def test_rivals_find_what_all_views_agree_on():
    same = evidence([0, 1, 2], [2, 0, 1], [1, 2, 0])
    for labels in (mask_clustering(same, boxes(), Agreement()), light_splat(same, Alike(0.5, 0.5, 10))):
        found = parts(labels)
        assert all(len(one) == 1 and -1 not in one for one in found)
        assert len(set.union(*found)) == 3
        assert sureness(same, np.unique(labels, return_inverse=True)[1]) == pytest.approx(1.0)


def test_a_mask_of_two_things_is_left_out_by_one_rule_and_chains_by_the_other():
    union = evidence([0, 1, 2], [0, 1, 2], [0, 1, 2], [0, 0, 1])
    first, second, third = parts(mask_clustering(union, boxes(), Agreement()))
    assert len(first) == len(second) == len(third) == 1
    assert len(first | second | third) == 3
    chained = parts(light_splat(union, Alike(0.4, 0.5, 10)))
    assert chained[0] == chained[1] != chained[2]
    assert len(set.union(*parts(light_splat(union, Alike(0.6, 0.5, 10))))) > 1


def test_a_row_between_two_masks_is_in_none_and_things_hang_together():
    weights = csr_array(np.float32([[0.6, 0.4], [0.9, 0.1]]))
    two = Evidence(weights, MaskIds(("a",), np.zeros(2, np.int32), np.arange(2, dtype=np.int32)), np.ones((2, 1), "f4"))
    assert dominant(two, 0.8).toarray().tolist() == [[0, 0], [1, 0]]
    assert dominant(two, 0.5).toarray().tolist() == [[1, 0], [1, 0]]
    labels = in_space(np.repeat([3, 3, -1], EACH), boxes())
    assert len(set(labels[:EACH])) == len(set(labels[EACH : 2 * EACH])) == 1
    assert labels[0] != labels[EACH]
    assert set(labels[2 * EACH :]) == {-1}


def test_wrong_masks_keep_each_photo_s_weight_and_move_whole_masks():
    known = evidence(*([[0, 1, 2]] * 20))
    room = Room(None, np.arange(300), known, OWNERS, CATEGORIES)
    moved = with_wrong(room, 40).evidence.weights
    views = known.masks.views
    np.testing.assert_array_equal(moved.toarray().reshape(300, 20, 3).sum(2), 1)
    emptied = np.flatnonzero(moved.sum(0) == 0)
    assert 0.2 * len(views) < len(emptied) < 0.4 * len(views)
    np.testing.assert_array_equal(with_wrong(room, 0).evidence.weights.toarray(), known.weights.toarray())


def test_regions_are_the_labels_without_what_has_none():
    known = evidence([0, 1, 2], [0, 1, 2])
    room = Room(None, np.arange(300) + 5, known, OWNERS, CATEGORIES)
    first, second = regions_of(room, np.repeat([-1, 9, 4], EACH))
    assert (first.ids[0], second.ids[0]) == (205, 105)
    assert (first.score, second.score) == (1.0, 1.0)
