"""Vectors in six bits a number."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from drsplat.query.sketch import Packed


@pytest.mark.parametrize("dim", [1, 2, 3, 4, 24, 513])
@pytest.mark.parametrize("count", [0, 7])
def test_numbers_are_packed_in_six_bits(dim, count):
    numbers = np.random.default_rng(dim).integers(-31, 32, (count, dim)).astype(np.float32)
    numbers[:1] = 31
    packed = Packed.of(numbers / 64)
    assert packed.data.nbytes == count * 3 * -(-dim // 4)
    assert len(packed) == count
    assert packed.vectors.shape == (count, dim)
    assert_allclose(packed.vectors, numbers / 64, rtol=1e-6)


@given(arrays(np.float32, st.tuples(st.integers(0, 9), st.integers(1, 9)), elements=st.floats(-1, 1, width=32)))
def test_numbers_are_off_by_half_a_step_at_most(vectors):
    packed = Packed.of(vectors)
    assert (np.abs(packed.vectors - vectors) <= 0.5001 * packed.steps).all()


@given(st.integers(0, 9), st.integers(1, 40), st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_products_are_those_of_the_vectors(count, dim, queries, seed):
    rng = np.random.default_rng(seed)
    packed = Packed(rng.integers(0, 256, (count, 3 * -(-dim // 4)), np.uint8), rng.random(dim, np.float32))
    given_ones = rng.standard_normal((queries, dim)).astype(np.float32)
    expected = given_ones.astype(np.float64) @ packed.vectors.T.astype(np.float64)
    assert_allclose(packed.products(given_ones), expected, rtol=1e-5, atol=1e-3)
