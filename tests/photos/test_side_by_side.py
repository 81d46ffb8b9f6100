"""Photos side by side: the files of one after the other, and no more at a time than said."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_embedding import a_view

from drsplat.photos.embedding.embed import MAX_PHOTOS_AT_ONCE, embed, photos_at_once, side_by_side
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.mini import MiniEncoder
from fake_models import ColorSegmenter


@given(st.lists(st.integers(), max_size=20), st.integers(1, 5))
def test_results_come_in_order(items, at_once):
    assert list(side_by_side(lambda item: item + 1, items, at_once)) == [item + 1 for item in items]


def test_as_many_work_at_once_as_said():
    """All three have to be there before one goes on."""
    barrier = threading.Barrier(3, timeout=30)
    assert len(list(side_by_side(lambda _: barrier.wait(), range(9), 3))) == 9


@pytest.mark.parametrize("at_once", [1, 2, 4])
def test_no_more_are_begun_than_said(at_once):
    taken = 0
    begun = []

    def items():
        for item in range(12):
            assert len(begun) - taken < at_once
            begun.append(item)
            yield item

    for _ in side_by_side(lambda item: item, items(), at_once):
        taken += 1
    assert taken == 12


def test_what_came_before_an_error_is_there():
    def work(item):
        return 6 / (3 - item)

    found = side_by_side(work, range(9), 2)
    assert [next(found) for _ in range(3)] == [2.0, 3.0, 6.0]
    with pytest.raises(ZeroDivisionError):
        next(found)


def test_other_models_take_one_photo_at_a_time():
    both = GraphSegmenter(threads=3), MiniEncoder(threads=2)
    assert photos_at_once(both) == 2
    assert photos_at_once([GraphSegmenter(threads=99), MiniEncoder(threads=99)]) == MAX_PHOTOS_AT_ONCE
    assert photos_at_once([ColorSegmenter(), both[1]]) == 1


def test_files_are_the_same_bytes_at_any_number_of_threads(tmp_path):
    views = [a_view(tmp_path, f"{i}.png", 120, 90, seed=i) for i in range(5)]
    for threads in (1, 3):
        embed(views, tmp_path / str(threads), GraphSegmenter(threads=threads), MiniEncoder(threads=threads))
    one, three = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir() if path.is_file()} for name in "13"
    )
    assert len(one) >= 5
    assert one == three
