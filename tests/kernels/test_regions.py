"""Regions that masks hold together: closed forms, the slow twin, laws, threads, and arrays that are not so."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array

from drsplat.field.objects.block_nodes import along_a_curve, neighbours
from drsplat.kernels import Forest, MergeRule, agglomerate
from refusing import refused
from twins import regions as twin

RULE = MergeRule(soft=0.5, far=2.0, unit=0.7, smallest=3)
THRESHOLDS = tuple(k / 100 for k in range(95, 10, -5))


def votes(seed: int, rows: int = 40, views: int = 5, masks: int = 4) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Rows in a line, of which each view sees some, cut into runs by masks with soft borders."""
    rng = default_rng(seed)
    dense = np.zeros((rows, views * masks), np.float32)
    for view in range(views):
        owner = np.searchsorted(np.sort(rng.integers(0, rows, masks - 1)), np.arange(rows), side="right")
        mass = rng.random(rows) * (rng.random(rows) < 0.8)
        stray = rng.integers(0, masks, rows)
        share = 0.7 + 0.3 * rng.random(rows)
        dense[np.arange(rows), view * masks + owner] += (mass * share).astype(np.float32)
        dense[np.arange(rows), view * masks + stray] += (mass * (1 - share)).astype(np.float32)
    embeddings = rng.normal(size=(views * masks, 6)).astype(np.float32)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    return csr_array(dense), np.repeat(np.arange(views, dtype=np.int32), masks), embeddings


def line(rows: int) -> np.ndarray:
    pairs = [(a, a + step) for step in (1, 2) for a in range(rows - step)]
    return np.array(sorted(pairs), np.int32).reshape(-1, 2)


def grown(seed: int, threads: int = 1, rows: int = 40) -> Forest:
    return agglomerate(*votes(seed, rows), line(rows), THRESHOLDS, RULE, threads=threads)


def test_two_things_in_two_views_are_two_regions():
    """Closed form: a's rows are in mask 0 of each view and b's in mask 1; c = 1 / (1 + soft)."""
    dense = np.zeros((6, 4), np.float32)
    dense[:3, [0, 2]] = dense[3:, [1, 3]] = 1
    forest = agglomerate(csr_array(dense), np.int32([0, 0, 1, 1]), np.eye(4, dtype=np.float32)[:, :2] * 0
                         + np.float32([[1, 0], [0, 1], [1, 0], [0, 1]]), line(6), THRESHOLDS,
                         MergeRule(soft=1.0, far=1.0, smallest=3, unlike=0.0))  # fmt: skip
    roots = forest.parents < 0
    # The pull towards `prior` lets the two meet at the end: 2 c^2 * 0 + .15 over about 2 + .3 is below all thresholds.
    assert sorted(forest.sizes[roots]) == [3, 3]
    assert_allclose(forest.fits[roots], 1)
    assert_allclose(forest.masses[roots], 6)
    # of single rows c^2 = 1/4 in two views, all shared: (2 / 4 + .5 * .3) / (2 / 4 + .3) = 0.8125
    assert forest.agreements[forest.parents[0]] == pytest.approx(0.8)


def a_link() -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Two things of three rows each that three views tell apart, and a row between them that only the fourth sees,
    faintly and in one mask with both."""
    dense = np.zeros((7, 7), np.float32)
    for view in range(3):
        dense[:3, 2 * view] = dense[4:, 2 * view + 1] = 10
    dense[:3, 6] = dense[4:, 6] = 0.02
    dense[3, 6] = 2.0
    return csr_array(dense), np.int32([0, 0, 1, 1, 2, 2, 3]), np.tile(np.eye(2, dtype=np.float32)[:1], (7, 1))


@pytest.mark.parametrize("implementation", [agglomerate, twin.agglomerate])
def test_what_is_like_two_things_does_not_link_them(implementation):
    """The row between is the best neighbour of both, which agree by nearly 0: each goes its way from then on."""
    edges = np.int32([[a, b] for a in range(7) for b in range(a + 1, 7) if not (a < 3 and b > 3)])
    rule = MergeRule(soft=0.1, far=1.0, smallest=3, tolerance=1.0)

    def apart(rule):
        parents = implementation(*a_link(), edges, (0.45,), rule).parents
        return bool(parents[0] != parents[6])

    assert apart(rule)
    assert not apart(replace(rule, linked=0.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_native_is_the_twin(seed):
    fast = grown(seed)
    slow = twin.agglomerate(*votes(seed), line(40), THRESHOLDS, RULE)
    for name in ("parents", "sizes", "agreements"):
        assert_array_equal(getattr(fast, name), getattr(slow, name))
    for name in ("masses", "fits", "spreads"):
        assert_allclose(getattr(fast, name), getattr(slow, name), rtol=2e-5, atol=2e-6)


@given(st.integers(0, 10_000), st.integers(2, 90))
def test_a_forest_is_one(seed, rows):
    """Parents come later and hold the sum of their children; same bits at any number of threads."""
    forest = grown(seed, rows=rows)
    count = len(forest.parents)
    inner = forest.parents >= 0
    assert (forest.parents[inner] > np.flatnonzero(inner)).all()
    sums = np.bincount(forest.parents[inner], forest.sizes[inner], minlength=count)
    assert_array_equal(sums[rows:], forest.sizes[rows:])
    assert forest.sizes[~inner].sum() == rows
    assert ((forest.fits >= 0) & (forest.fits <= 1)).all()
    for threads in (2, 5):
        for one, other in zip(forest, grown(seed, threads, rows), strict=True):
            assert_array_equal(one, other)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.floats(0.01, 100))
def test_brighter_weights_change_nothing(seed, factor):
    """Weights times a factor, and soft and far with them, are the same question."""
    w, views, embeddings = votes(seed)
    scaled = csr_array((w.data * np.float32(2.0 ** round(np.log2(factor))), w.indices, w.indptr), shape=w.shape)
    factor = 2.0 ** round(np.log2(factor))
    rule = MergeRule(RULE.soft * factor, RULE.far * factor, unit=RULE.unit, smallest=RULE.smallest)
    one = agglomerate(w, views, embeddings, line(40), THRESHOLDS, RULE)
    other = agglomerate(scaled, views, embeddings, line(40), THRESHOLDS, rule)
    assert_array_equal(one.parents, other.parents)
    assert_array_equal(one.fits, other.fits)


@pytest.mark.parametrize("seed", range(3))
def test_rows_in_another_order_are_those_of_a_permuted_matrix(seed):
    w, views, embeddings = votes(seed)
    order = default_rng(seed).permutation(40)
    there = agglomerate(w, views, embeddings, line(40), THRESHOLDS, RULE, order=order)
    for found, expected in zip(
        there, agglomerate(csr_array(w[order]), views, embeddings, line(40), THRESHOLDS, RULE), strict=True
    ):
        assert_array_equal(found, expected)
    with refused("order"):
        agglomerate(w, views, embeddings, line(40), THRESHOLDS, RULE, order=order + 1)


def test_views_may_have_any_numbers():
    w, views, embeddings = votes(1)
    far = (views * 500_000_000 - 1_000_000_000).astype(np.int32)
    one = agglomerate(w, views, embeddings, line(40), THRESHOLDS, RULE)
    assert_array_equal(agglomerate(w, far, embeddings, line(40), THRESHOLDS, RULE).parents, one.parents)


def test_nothing_to_merge():
    none = np.zeros((0, 2), np.int32)
    empty = agglomerate(csr_array((0, 3), dtype=np.float32), np.zeros(3, np.int32), np.eye(3, dtype=np.float32), none,
                        THRESHOLDS, RULE)  # fmt: skip
    assert len(empty.parents) == 0
    unseen = agglomerate(csr_array((4, 0), dtype=np.float32), np.zeros(0, np.int32), np.zeros((0, 3), np.float32),
                         line(4), THRESHOLDS, RULE)  # fmt: skip
    assert unseen.fits.max() == 0  # no photo says anything; neighbours may be joined by the prior alone


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(edges=np.int32([[1, 0]])), "a < b"),
        (dict(edges=np.int32([[0, 40]])), "a < b < rows"),
        (dict(edges=np.int32([[-1, 3]])), "a < b"),
        (dict(views=np.arange(20, dtype=np.int32)[::-1].copy()), "order of their views"),
        (dict(views=np.zeros(3, np.int32)), "one view and embedding per mask"),
        (dict(embeddings=np.zeros((3, 6), np.float32)), "one view and embedding per mask"),
        (dict(rule=MergeRule(0.0, 1.0)), "soft"),
        (dict(rule=MergeRule(np.nan, 1.0)), "numbers of 0 or more"),
        (dict(rule=MergeRule(1.0, 1.0, rounds=-3)), "numbers of 0 or more"),
    ],
)
def test_arrays_that_are_not_so(change, words):
    w, views, embeddings = votes(0)
    given = dict(weights=w, views=views, embeddings=embeddings, edges=line(40), thresholds=THRESHOLDS, rule=RULE)
    with refused(words):
        agglomerate(**{**given, **change})


@pytest.mark.parametrize("broken", ["unsorted", "too large", "negative", "falling"])
def test_a_damaged_matrix_is_refused(broken):
    w, views, embeddings = votes(1)
    if broken == "unsorted":
        w.indices[:2] = w.indices[:2][::-1].copy()
    elif broken == "falling":
        w.indptr[3] = w.indptr[5] + 1
    else:
        w.indices[0] = 20 if broken == "too large" else -1
    with refused(r"column|row starts"):
        agglomerate(w, views, embeddings, line(40), THRESHOLDS, RULE)


def test_what_is_near_in_space_is_near_along_the_curve():
    points = default_rng(0).random((4000, 3))
    order = along_a_curve(np.concatenate([points, [[1e6, 0, 0]]]))  # a stray does not put all others in one cell
    assert_array_equal(np.sort(order), np.arange(4001))
    steps = np.linalg.norm(np.diff(points[order[order < 4000]], axis=0), axis=1)
    assert np.median(steps) < 0.1  # in no order 0.66
    assert len(along_a_curve(np.zeros((0, 3)))) == 0


def test_neighbours_of_points_in_one_place_and_of_few():
    assert neighbours(np.zeros((1, 3))).shape == (0, 2)
    assert neighbours(np.zeros((0, 3))).shape == (0, 2)
    assert neighbours(np.array([[0, 0, 0], [1, 0, 0.0]])).tolist() == [[0, 1]]
    same = neighbours(np.zeros((40, 3)))
    assert (same[:, 0] < same[:, 1]).all()
    far = np.concatenate([default_rng(0).random((200, 3)), [[50.0, 0, 0]]])
    alone = neighbours(far)
    assert (alone != 200).all() or np.linalg.norm(far[alone[alone[:, 1] == 200][0, 0]] - far[200]) < 50
