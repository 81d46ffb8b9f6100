"""The mixture code's kernels against their float64 twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.field.codes.mixture import quantised
from drsplat.field.codes.mixture.code import packed
from drsplat.kernels import available_isas
from drsplat.kernels.mixture import (
    Blocks,
    Candidates,
    Dictionary,
    mixture_best,
    mixture_encode,
    mixture_scores,
    mixture_select,
    mixture_top,
    nearest_centres,
    nearest_members,
)
from fields import unit_rows
from refusing import refused
from twins import mixture as reference_mixture

every_isa = pytest.mark.parametrize("isa", available_isas())
few = settings(derandomize=True, max_examples=40)


def candidates_of(rng: np.random.Generator, rows: int, atoms: int, further: int = 0) -> Candidates:
    lengths = rng.integers(0, min(atoms, 40), rows)
    lengths[0] = 0
    columns = [rng.choice(atoms, length, replace=False) for length in lengths]
    return Candidates(
        np.concatenate([[0], np.cumsum(lengths)]),
        np.concatenate(columns).astype(np.int32),
        rng.integers(0, atoms, (rows, further)).astype(np.int32),
    )


def random_code(
    rng: np.random.Generator, rows: int = 200, atoms: int = 90, per_row: int = 4, dim: int = 48
) -> tuple[Blocks, Dictionary]:
    """Some rows of it are zero."""
    ids = rng.integers(0, atoms, (rows, per_row)).astype(np.uint16)
    weights = rng.integers(0, 256, (rows, per_row)).astype(np.uint8)
    scales = rng.uniform(0.0005, 0.004, rows).astype(np.float16)
    weights[::7], scales[::7] = 0, 0
    return packed(ids, weights, scales), quantised(unit_rows(rng, atoms, dim))


def cosines(found: np.ndarray, features: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(found, axis=1) * np.linalg.norm(features, axis=1)
    return np.einsum("nd,nd->n", found, features) / np.where(norms > 0, norms, 1)


def decoded(encoded: tuple[np.ndarray, ...], dictionary: Dictionary) -> np.ndarray:
    ids, weights, scales = encoded
    table = reference_mixture.atoms(dictionary)
    return np.einsum("nk,nkd->nd", weights.astype(float), table[ids]) * scales[:, None]


@every_isa
def test_of_orthogonal_atoms_the_heaviest_are_chosen(isa):
    rng = default_rng(0)
    features = rng.random((50, 20)).astype(np.float32)
    everything = np.tile(np.arange(20, dtype=np.int32), 50)
    given = Candidates(np.arange(51) * 20, everything, np.empty((50, 0), np.int32))
    ids, weights, scales = mixture_encode(features, quantised(np.eye(20, dtype=np.float32)), given, 5, isa=isa)
    heaviest = np.argsort(-features, axis=1)[:, :5]
    assert_array_equal(ids, heaviest)
    chosen = np.take_along_axis(features, heaviest, axis=1)
    assert_array_equal(weights, np.floor(chosen / chosen[:, :1] * 255 + 0.5))
    assert_allclose(scales, 1 / np.linalg.norm(weights.astype(float), axis=1), rtol=1e-6)


@every_isa
@pytest.mark.parametrize("dim", [3, 16, 47, 128, 512])
def test_a_row_of_few_atoms_is_found_again(isa, dim):
    rng = default_rng(dim)
    dictionary = quantised(unit_rows(rng, 30, dim))
    table = reference_mixture.atoms(dictionary)
    wanted = min(3, dim)
    picked = np.stack([rng.choice(30, wanted, replace=False) for _ in range(60)])
    features = np.einsum("nk,nkd->nd", rng.uniform(0.3, 1, picked.shape), table[picked])
    features = (features / np.linalg.norm(features, axis=1, keepdims=True)).astype(np.float32)
    given = Candidates(np.arange(61) * wanted, picked.ravel().astype(np.int32), np.empty((60, 0), np.int32))
    found = mixture_encode(features, dictionary, given, wanted, isa=isa)
    assert cosines(decoded(found, dictionary), features).min() > 0.9999
    assert_allclose(np.linalg.norm(decoded(found, dictionary), axis=1), 1, atol=1e-5)


@pytest.mark.slow
@every_isa
@pytest.mark.parametrize(("per_row", "further"), [(1, 0), (2, 3), (4, 16), (8, 5), (16, 0)])
def test_encoding_is_that_of_the_twin(isa, per_row, further):
    rng = default_rng(per_row)
    common = rng.standard_normal(64)
    dictionary = quantised((rng.standard_normal((120, 64)) + common).astype(np.float32))
    given = candidates_of(rng, 150, 120, further)
    features = unit_rows(rng, 150, 64) * 0.6 + (common / np.linalg.norm(common)).astype(np.float32)
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    found = mixture_encode(features, dictionary, given, per_row, isa=isa)
    expected = reference_mixture.mixture_encode(features, dictionary, given, per_row)
    ours, theirs = (cosines(decoded(code, dictionary), features) for code in (found, expected))
    same = (np.sort(found.ids) == np.sort(expected.ids)).all(axis=1)
    assert same.mean() >= 0.97
    assert_allclose(ours[same], theirs[same], atol=1e-4)
    assert abs(ours.mean() - theirs.mean()) < 1e-3
    assert (np.diff(found.weights.astype(int), axis=1) <= 0).all()


@few
@given(st.integers(0, 10_000))
def test_more_atoms_never_fit_worse_and_all_are_candidates(seed):
    rng = default_rng(seed)
    dictionary, given = quantised(unit_rows(rng, 40, 24)), candidates_of(rng, 20, 40, 2)
    features = unit_rows(rng, 20, 24)
    previous = np.zeros(20)
    for per_row in (1, 2, 4, 8):
        found = mixture_encode(features, dictionary, given, per_row, threads=1)
        fit = cosines(decoded(found, dictionary), features)
        assert (fit > previous - 0.02).all()  # greedy: nearly
        previous = fit
        for i in range(20):
            own = given.columns[given.indptr[i] : given.indptr[i + 1]]
            chosen = found.ids[i][found.weights[i] > 0]
            assert set(chosen) <= {*own, *given.further[i]}
            assert len(set(chosen)) == len(chosen)


def test_rows_without_candidates_or_direction_are_zero():
    rng = default_rng(1)
    dictionary = quantised(unit_rows(rng, 5, 8))
    opposite = -reference_mixture.atoms(dictionary)[2:3].astype(np.float32)
    features = np.concatenate([unit_rows(rng, 1, 8), np.zeros((1, 8), np.float32), opposite])
    given = Candidates(np.array([0, 0, 3, 4]), np.int32([0, 1, 2, 2]), np.empty((3, 0), np.int32))
    ids, weights, scales = mixture_encode(features, dictionary, given, 4)
    assert not ids[:1].any()
    assert not weights.any()
    assert not scales.any()


def test_equal_atoms_and_atoms_without_direction_do_no_harm():
    vectors = np.repeat(unit_rows(default_rng(2), 2, 16), 4, axis=0)
    vectors[7] = 0
    given = Candidates(np.array([0, 8]), np.arange(8, dtype=np.int32), np.zeros((1, 2), np.int32))
    feature = (vectors[:1] + vectors[4:5]) / np.linalg.norm(vectors[0] + vectors[4])
    dictionary = quantised(vectors)
    found = mixture_encode(feature, dictionary, given, 8)
    assert (found.weights > 0).sum() == 2
    assert cosines(decoded(found, dictionary), feature)[0] > 0.9999


@every_isa
def test_nearest_centres_are_those_of_the_twin(isa):
    rng = default_rng(3)
    for count, dim in ((1, 5), (3, 16), (64, 33), (203, 64)):
        points, centres = unit_rows(rng, 131, dim), unit_rows(rng, count, dim)
        expected = reference_mixture.nearest_centres(points, centres)
        assert_array_equal(nearest_centres(points, centres, isa=isa), expected)
    assert_array_equal(nearest_centres(points, centres[[4, 4, 4]], isa=isa), np.zeros(131))


@every_isa
def test_nearest_members_are_those_of_the_twin(isa):
    rng = default_rng(4)
    dictionary, points = quantised(unit_rows(rng, 80, 40)), unit_rows(rng, 90, 40)
    members = np.stack([rng.choice(80, 30, replace=False) for _ in range(6)]).astype(np.int32)
    groups = rng.integers(0, 6, 90).astype(np.int32)
    given = points, dictionary, groups, members
    for wanted in (1, 7, 30):
        found = nearest_members(*given, wanted, isa=isa)
        expected = reference_mixture.nearest_members(*given, wanted)
        assert (found == expected).mean() > 0.99


@every_isa
@pytest.mark.parametrize("per_row", [1, 2, 3, 4, 5, 8, 16])
@pytest.mark.parametrize(("rows", "dim"), [(1, 1), (64, 35), (200, 64), (4099, 16), (77, 768)])
def test_scores_are_those_of_the_twin(isa, per_row, rows, dim):
    rng = default_rng(rows + per_row)
    blocks, dictionary = random_code(rng, rows, per_row=per_row, dim=dim)
    queries = unit_rows(rng, 3, dim)
    found = mixture_scores(blocks, dictionary, queries, isa=isa)
    expected = reference_mixture.mixture_scores(blocks, dictionary, queries)
    _, weights = reference_mixture.in_rows(blocks)
    tolerance = 4e-5 * weights.sum(axis=1) * blocks.scales.astype(float)
    assert (np.abs(found - expected) <= tolerance + 1e-7).all()
    assert not found[:, ::7].any()


def test_flat_and_spiky_queries_keep_their_digits():
    rng = default_rng(5)
    blocks, _ = random_code(rng, dim=512)
    flat = np.full((90, 512), 512**-0.5, np.float32)  # as large as sums of products get
    spiky = np.eye(512, dtype=np.float32)[:90]
    for vectors in (flat, spiky):
        dictionary = quantised(vectors)
        found = mixture_scores(blocks, dictionary, vectors[:2])
        expected = reference_mixture.mixture_scores(blocks, dictionary, vectors[:2])
        assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("count", [1, 2, 31, 33, 256, 257, 600])
@pytest.mark.parametrize("per_row", [1, 4, 5, 16])
def test_the_best_are_those_of_all_scores_to_the_bit(count, per_row):
    rng = default_rng(count)
    blocks, dictionary = random_code(rng, 150, per_row=per_row)
    queries = unit_rows(rng, count, 48)
    queries[count // 2 :: 5] = queries[0]  # ties
    scores = mixture_scores(blocks, dictionary, queries)
    for isa in available_isas():
        index, best, runner_up = mixture_best(blocks, dictionary, queries, isa=isa)
        ranked = np.sort(scores, axis=0)
        assert_array_equal(best, ranked[-1])
        assert_array_equal(runner_up, ranked[-2] if count > 1 else np.full(150, -np.inf))
        assert_array_equal(scores[index, np.arange(150)], best)
        # rows of one rounded score for two queries aside, the first of the best
        assert (index == scores.argmax(axis=0)).mean() > 0.99


@few
@given(st.integers(0, 10_000), st.floats(-0.3, 0.3), st.booleans())
def test_selections_are_those_of_all_scores(seed, threshold, floored):
    rng = default_rng(seed)
    blocks, dictionary = random_code(rng, int(rng.integers(1, 9000)), dim=16)
    query, rows = unit_rows(rng, 1, 16), len(blocks.scales)
    floor = rng.uniform(-0.2, 0.2, rows).astype(np.float32) if floored else None
    scores = mixture_scores(blocks, dictionary, query)[0]
    found, kept = mixture_select(blocks, dictionary, query[0], threshold, floor)
    expected = np.flatnonzero(scores - (0 if floor is None else floor) > np.float32(threshold))
    assert_array_equal(found, expected)
    assert_array_equal(kept, scores[expected])


@pytest.mark.parametrize("count", [1, 10, 5000, 20_000])
def test_the_top_rows_are_those_of_all_scores(count):
    rng = default_rng(8)
    blocks, dictionary = random_code(rng, 15_000, atoms=20, per_row=1, dim=16)  # many ties
    query = unit_rows(rng, 1, 16)
    scores = mixture_scores(blocks, dictionary, query)[0]
    rows, kept = mixture_top(blocks, dictionary, query[0], count)
    order = np.lexsort((np.arange(15_000), -scores))[:count]
    assert_array_equal(rows, order)
    assert_array_equal(kept, scores[order])


@every_isa
def test_threads_change_no_bit(isa):
    rng = default_rng(9)
    blocks, dictionary = random_code(rng, 20_000)
    queries, given = unit_rows(rng, 40, 48), candidates_of(rng, 900, 90, 4)
    features = unit_rows(rng, 900, 48)

    def everything(threads):
        how = {"threads": threads, "isa": isa}
        return [
            *mixture_encode(features, dictionary, given, 4, **how),
            nearest_centres(features, queries, **how),
            mixture_scores(blocks, dictionary, queries, **how),
            *mixture_select(blocks, dictionary, queries[0], 0.05, **how),
            *mixture_top(blocks, dictionary, queries[0], 100, **how),
            *mixture_best(blocks, dictionary, queries, **how),
        ]

    for one, three in zip(everything(1), everything(3), strict=True):
        assert_array_equal(one, three)


def test_instruction_sets_and_groupings_of_queries_change_no_bit_of_a_score():
    rng = default_rng(10)
    blocks, dictionary = random_code(rng, 500, dim=75)
    queries = unit_rows(rng, 70, 75)
    expected = mixture_scores(blocks, dictionary, queries, isa="portable")
    for isa in available_isas():
        assert_array_equal(mixture_scores(blocks, dictionary, queries, isa=isa), expected)
        for i in (0, 69):
            alone = mixture_scores(blocks, dictionary, queries[i : i + 1], isa=isa)
            assert_array_equal(alone[0], expected[i])


@every_isa
def test_ids_of_no_atom_score_nothing(isa):
    """Files are checked when they are read; the kernels are safe without."""
    blocks, dictionary = random_code(default_rng(12))
    wild = Blocks(np.full_like(blocks.ids, 65535), blocks.weights, blocks.scales)
    queries = unit_rows(default_rng(13), 40, 48)
    assert not mixture_scores(wild, dictionary, queries, isa=isa).any()
    index, scores, _ = mixture_best(wild, dictionary, queries, isa=isa)
    assert not scores.any()
    assert ((index >= 0) & (index < 40)).all()


def test_bad_arguments_are_refused():
    rng = default_rng(14)
    blocks, dictionary = random_code(rng)
    query, short = unit_rows(rng, 1, 48), unit_rows(rng, 1, 47)
    with refused("queries"):
        mixture_scores(blocks, dictionary, short)
    with refused("finite"):
        mixture_scores(blocks, dictionary, np.full((1, 48), np.nan, np.float32))
    with refused("a query"):
        mixture_best(blocks, dictionary, np.empty((0, 48), np.float32))
    with refused("floor"):
        mixture_select(blocks, dictionary, query[0], 0.0, np.zeros(3, np.float32))
    with refused("1 or more"):
        mixture_top(blocks, dictionary, query[0], 0)
    with refused("blocks"):
        mixture_scores(Blocks(blocks.ids[1:], *blocks[1:]), dictionary, query)
    features = unit_rows(rng, 2, 48)
    none = np.empty((2, 0), np.int32)
    good = np.array([0, 1, 2]), np.int32([0, 89]), none
    for starts, columns, further in (
        (np.array([0, 2, 1]), good[1], none),
        (np.array([0, 1, 3]), good[1], none),
        (good[0], np.int32([0, 90]), none),
        (good[0], np.int32([0, -1]), none),
        (good[0], good[1], np.full((2, 1), 90, np.int32)),
        (good[0], good[1], np.zeros((2, 65), np.int32)),
    ):
        with refused("expected"):
            mixture_encode(features, dictionary, Candidates(starts, columns, further), 4)
    for per_row in (0, 17):
        with refused("1 to 16"):
            mixture_encode(features, dictionary, Candidates(*good), per_row)
    with refused("finite"):
        mixture_encode(features * np.float32(np.inf), dictionary, Candidates(*good), 4)
    with refused("centres"):
        nearest_centres(features, np.empty((0, 48), np.float32))
    with refused("members"):
        nearest_members(features, dictionary, np.int32([0, 3]), np.zeros((3, 2), np.int32), 2)
