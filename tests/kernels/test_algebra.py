"""The algebra after registration against its float64 twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from test_views_hostile import unchecked_types

from drsplat.errors import InputError
from drsplat.kernels import available_isas, pq_encode, weighted_rows
from drsplat.kernels.algebra import changed_columns, code_sums, convolve, dense_rows, place_entries, row_products
from fields import random_weights, unit_rows
from refusing import refused
from twins import algebra as reference_algebra

every_isa = pytest.mark.parametrize("isa", available_isas())
few = settings(derandomize=True, max_examples=40)


@every_isa
@pytest.mark.parametrize("dim", [1, 3, 16, 35, 128, 512, 768])
def test_weighted_rows_are_those_of_the_twin(isa, dim):
    rng = default_rng(dim)
    w = random_weights(rng, 150, 300, 0.05)
    csr, embeddings = (w.indptr, w.indices, w.data), unit_rows(rng, 300, dim)
    rows = weighted_rows(*csr, embeddings, 7, 140, isa=isa)
    expected = reference_algebra.weighted_rows(*csr, embeddings, 7, 140)
    if dim == 1:  # a sum near zero has no certain sign
        assert_allclose(np.abs(rows), np.abs(expected), atol=1e-6)
    else:
        errors = np.linalg.norm(rows - expected, axis=1)
        assert errors.max() <= 1e-6
    assert_array_equal(rows.any(axis=1), np.diff(w.indptr)[7:140] > 0)


@every_isa
def test_long_rows_keep_their_precision(isa):
    rng = default_rng(0)
    embeddings = unit_rows(rng, 500, 64)
    weights = rng.lognormal(0, 3, 40_000).astype(np.float32)
    columns = rng.integers(0, 500, 40_000).astype(np.int32)
    csr = np.array([0, 40_000]), columns, weights
    row = weighted_rows(*csr, embeddings, 0, 1, isa=isa)
    assert np.linalg.norm(row - reference_algebra.weighted_rows(*csr, embeddings, 0, 1)) <= 1e-6


def test_tiny_and_huge_weights_are_normalised_alike():
    embeddings = unit_rows(default_rng(1), 2, 48)
    csr = np.array([0, 2, 4, 6]), np.array([0, 1] * 3, np.int32)
    weights = np.float32([3, 1, 3e-25, 1e-25, 3e25, 1e25])
    rows = weighted_rows(*csr, weights, embeddings, 0, 3)
    assert_allclose(np.linalg.norm(rows, axis=1), 1, rtol=1e-6)
    assert_allclose(rows[1:], rows[[0, 0]], atol=1e-6)


def test_rows_that_cancel_or_are_empty_stay_zero():
    embeddings = np.float32([[1, 0], [-1, 0]])
    csr = np.array([0, 2, 2, 3]), np.int32([0, 1, 1]), np.float32([2, 2, 0])
    assert_array_equal(weighted_rows(*csr, embeddings, 0, 3), np.zeros((3, 2)))


@every_isa
@few
@given(st.integers(0, 70), st.integers(0, 200), st.integers(0, 70), st.integers(0, 99))
def test_dense_rows_are_those_of_the_twin(isa, rows, depth, width, seed):
    rng = default_rng(seed)
    a, b = (rng.standard_normal(shape).astype(np.float32) for shape in ((rows, depth), (depth, width)))
    assert_allclose(dense_rows(a, b, isa=isa), reference_algebra.dense_rows(a, b), rtol=0, atol=1e-4)
    part = slice(rows // 3, rows)
    assert_array_equal(dense_rows(a[part], b, threads=2, isa=isa), dense_rows(a, b, threads=1, isa=isa)[part])


@every_isa
@few
@given(*(st.integers(*ends) for ends in ((0, 9), (1, 12), (1, 12), (0, 9), (0, 50), (1, 4), (0, 99))))
def test_convolutions_are_those_of_the_twin(isa, count, height, width, channels, outputs, stride, seed):
    rng = default_rng(seed)
    shapes = (count, height, width, channels), (9 * channels, outputs), (outputs,)
    images, weight, bias = (rng.standard_normal(shape).astype(np.float32) for shape in shapes)
    found = convolve(images, weight, bias, stride, threads=1, isa=isa)
    assert_allclose(found, reference_algebra.convolve(images, weight, bias, stride), rtol=0, atol=1e-4)
    part = slice(count // 3, count)
    assert_array_equal(convolve(images[part], weight, bias, stride, threads=2, isa=isa), found[part])


def test_convolutions_that_do_not_fit_are_refused():
    images = np.zeros((1, 4, 4, 2), np.float32)
    with refused(r"weights \(17, 16\)"):
        convolve(images, np.zeros((17, 16), np.float32), np.zeros(16, np.float32))
    with refused("stride 0"):
        convolve(images, np.zeros((18, 16), np.float32), np.zeros(16, np.float32), 0)


@few
@given(st.integers(0, 300), st.integers(1, 40), st.integers(1, 9), st.integers(0, 99))
def test_sums_of_codes_are_those_of_the_twin(rows, subvectors, dim, seed):
    rng = default_rng(seed)
    points = rng.standard_normal((rows, subvectors * dim)).astype(np.float32)
    codes = rng.integers(0, 256, (rows, subvectors)).astype(np.uint8)
    for threads in (1, 3):
        sums, counts = code_sums(points, codes, threads=threads)
        wanted = reference_algebra.code_sums(points, codes)
        assert_array_equal(sums, wanted[0])
        assert_array_equal(counts, wanted[1])


def test_codes_of_other_points_are_refused():
    with refused(r"got \(4, 7\) and \(4, 2\)"):
        code_sums(np.zeros((4, 7), np.float32), np.zeros((4, 2), np.uint8))


def test_matrices_that_do_not_fit_are_refused():
    with unchecked_types(), refused(r"got \(3, 4\) and \(5, 6\)"):
        dense_rows(np.zeros((3, 4), np.float32), np.zeros((5, 6), np.float32))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("dim", [3, 17, 512])
def test_row_products_do_not_depend_on_the_rows_beside(dim, kind):
    """A BLAS cuts them into a part for each thread."""
    rng = default_rng(dim)
    rows, vector = rng.normal(size=(5003, dim)).astype(kind), rng.normal(size=dim).astype(kind)
    products = row_products(rows, vector)
    assert products.dtype == kind
    assert_allclose(products, rows.astype(np.float64) @ vector, rtol=0, atol=1e-3 if kind == np.float32 else 1e-11)
    for part in (slice(1, 2), slice(3, 700), slice(2501, None)):
        assert_array_equal(row_products(rows[part], vector), products[part])


@every_isa
def test_any_number_of_threads_gives_the_same_bits(isa):
    rng = default_rng(2)
    w, embeddings = random_weights(rng, 900, 200, 0.05), unit_rows(rng, 200, 96)
    centroids = rng.standard_normal((24, 256, 4)).astype(np.float32) / 10

    def everything(threads):
        rows = weighted_rows(w.indptr, w.indices, w.data, embeddings, 0, 900, threads=threads, isa=isa)
        return [rows, pq_encode(rows, centroids, threads=threads, isa=isa)]

    for threads in (2, 3):
        for one, many in zip(everything(1), everything(threads), strict=True):
            assert_array_equal(one, many)


@pytest.mark.parametrize(
    ("indptr", "column", "rows"),
    [
        ([0, 2], 5, (0, 1)),
        ([0, 2], -1, (0, 1)),
        ([0, 3], 0, (0, 1)),
        ([-1, 2], 0, (0, 1)),
        ([2, 0], 0, (0, 1)),
        ([0, 2, 1], 0, (0, 2)),
        ([0, 2], 0, (0, 2)),
        ([0, 2], 0, (1, 0)),
    ],
)
def test_damaged_weights_are_refused(indptr, column, rows):
    columns, data = np.int32([0, column]), np.ones(2, np.float32)
    with pytest.raises(InputError):
        weighted_rows(np.array(indptr), columns, data, np.ones((5, 8), np.float32), *rows)


@every_isa
@pytest.mark.parametrize("dim", [1, 2, 3, 4, 5, 8, 16])
@pytest.mark.parametrize("rows", [1, 31, 33])
def test_codes_are_nearest_centroids(isa, dim, rows):
    rng = default_rng(dim)
    features = rng.standard_normal((rows, 6 * dim)).astype(np.float32)
    centroids = rng.standard_normal((6, 256, dim)).astype(np.float32)
    codes = pq_encode(features, centroids, isa=isa)
    distances = reference_algebra.pq_distances(features, centroids)
    chosen = np.take_along_axis(distances, codes[:, :, None].astype(np.intp), 2)[:, :, 0]
    assert_allclose(chosen, distances.min(axis=2), rtol=1e-6, atol=1e-12)
    assert_array_equal(codes, reference_algebra.pq_encode(features, centroids))


@every_isa
def test_ties_go_to_the_lowest_centroid(isa):
    centroids = np.zeros((3, 256, 4), np.float32)
    centroids[0, 7:] = 1  # 7 and all after it are one point
    centroids[1, ::2] = 1
    centroids[2, 255] = 1
    features = np.ones((40, 12), np.float32)
    assert_array_equal(pq_encode(features, centroids, isa=isa), np.tile([7, 0, 255], (40, 1)))


@every_isa
def test_a_feature_equal_to_a_centroid_gets_its_code(isa):
    """Also far from the origin, where expanded squares would cancel."""
    rng = default_rng(3)
    centroids = (100 + 1e-4 * rng.standard_normal((8, 256, 4))).astype(np.float32)
    codes = rng.integers(0, 256, (64, 8)).astype(np.uint8)
    first = [[np.argmax((c == c[k]).all(axis=1)) for c, k in zip(centroids, row, strict=True)] for row in codes]
    features = reference_algebra.pq_decode(codes, centroids).astype(np.float32)
    assert_array_equal(pq_encode(features, centroids, isa=isa), first)


def test_arguments_that_do_not_fit_are_refused():
    features, centroids = np.zeros((4, 6), np.float32), np.zeros((3, 256, 2), np.float32)
    with refused("centroids"):
        pq_encode(features, centroids[:2])
    with refused("centroids"):
        pq_encode(features, centroids[:, :255])
    with refused("finite"):
        pq_encode(np.full((4, 6), np.nan, np.float32), centroids)
    with refused("instruction set"):
        pq_encode(features, centroids, isa="z80")


@pytest.mark.parametrize("threads", [1, 3])
def test_columns_are_numbered_anew_taken_out_and_put_in(threads):
    rng = default_rng(threads)
    old, more = random_weights(rng, 9000, 20, 0.2), random_weights(rng, 9000, 6, 0.1)
    numbers = np.int32([-1, 0, 1, 3, 5, -1, *range(7, 20), 23])  # 2, 4, 6 and 20 to 22 are new
    new = np.int32([2, 4, 6, 20, 21, 22])
    given = (more.indptr, new[more.indices], more.data)
    starts, columns, values = changed_columns((old.indptr, old.indices, old.data), numbers, given, threads=threads)
    expected = np.zeros((9000, 24), np.float32)
    expected[:, numbers[numbers >= 0]], expected[:, new] = old.toarray()[:, numbers >= 0], more.toarray()
    assert_array_equal(csr_array((values, columns, starts), shape=expected.shape).toarray(), expected)
    rows = np.repeat(np.arange(9000), np.diff(starts))
    assert (np.diff(rows * 24 + columns) > 0).all()
    with refused("a number for each column"):
        changed_columns((old.indptr, old.indices, old.data), numbers[:19], given)
    with refused("as many rows"):
        changed_columns((old.indptr, old.indices, old.data), numbers, (more.indptr[:-1], *given[1:]))


def test_entries_of_views_are_put_into_rows():
    rng = default_rng(3)
    parts = [random_weights(rng, 500, width, 0.2).tocoo() for width in (7, 1, 4)]
    starts = np.zeros(501, np.int64)
    for part in parts:
        np.add.at(starts, part.row + 1, 1)
    np.cumsum(starts, out=starts)
    following, columns, weights = starts[:-1].copy(), np.empty(starts[-1], np.int32), np.empty(starts[-1], np.float32)
    for part, first in zip(parts, (0, 7, 8), strict=True):
        entries = part.row.astype(np.uint32), part.col.astype(np.int32), part.data
        place_entries(entries, first, following, columns, weights)
    expected = np.hstack([part.toarray() for part in parts])
    assert_array_equal(csr_array((weights, columns, starts), shape=expected.shape).toarray(), expected)
    with refused("room for their entries"):  # all rows are full but for the last, after which there is no room
        place_entries((np.uint32([499]), np.int32([0]), np.float32([1])), 0, following, columns, weights)
    with refused("rows that there are"):
        place_entries((np.uint32([500]), np.int32([0]), np.float32([1])), 0, following, columns, weights)
