"""The best of many scores, kept while more come: the kernel against sorting all of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from test_views_hostile import unchecked_types

from drsplat.errors import InputError
from drsplat.kernels import available_isas
from drsplat.kernels.scan import keep_best
from twins import ranking as twin

every_isa = pytest.mark.parametrize("isa", available_isas())
few = settings(derandomize=True, max_examples=60)


def nothing(rows: int, kept: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full((kept, rows), -np.inf, np.float32), np.zeros((kept, rows), np.uint16)


@every_isa
@few
@given(st.integers(0, 60), st.integers(1, 20), st.integers(1, 30), st.integers(1, 9), st.integers(0, 999))
def test_what_is_kept_is_what_sorting_keeps(isa, rows, kept, count, step, seed):
    """With many equal scores, of both zeros, in steps of any size."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([-np.inf, -1.5, -0.0, 0.0, 0.25, 3e38, np.inf], (count, rows)).astype(np.float32)
    found = np.where(rng.random((count, rows)) < 0.5, levels, rng.standard_normal((count, rows))).astype(np.float32)
    best, expected = nothing(rows, kept), nothing(rows, kept)
    for begin in range(0, count, step):
        some = found[begin : begin + step]
        keep_best(*best, some, begin, threads=2, isa=isa)
        expected = twin.keep_best(*expected, some, begin)
    assert_array_equal(best[0], expected[0])
    assert_array_equal(best[1], expected[1])


@every_isa
def test_any_number_of_threads_gives_the_same_bits(isa):
    found = np.random.default_rng(1).standard_normal((8, 20_000)).astype(np.float32)
    one, three = nothing(20_000, 9), nothing(20_000, 9)
    keep_best(*one, found, 65_528, threads=1, isa=isa)
    keep_best(*three, found, 65_528, threads=3, isa=isa)
    assert_array_equal(one[0].view(np.int32), three[0].view(np.int32))
    assert_array_equal(one[1], three[1])
    assert one[1].max() == 65_535


def test_arrays_that_do_not_fit_are_refused():
    found = np.zeros((8, 5), np.float32)
    for best, first in ((nothing(4, 3), 0), (nothing(5, 257), 0), (nothing(5, 3), 65_529)):
        with unchecked_types(), pytest.raises(InputError, match=r"found \(8, 5\)"):
            keep_best(*best, found, first)
    best = nothing(5, 3)
    best[0].setflags(write=False)
    with pytest.raises(InputError):
        keep_best(*best, found, 0)
