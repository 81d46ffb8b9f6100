"""Aggregators over the rows of W: each rule against a slow twin, and the laws that all keep, those of the benchmark
too."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.suite.aggregators import MEASURED
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array

from drsplat.errors import InputError
from drsplat.field.evidence.aggregation import AGGREGATORS, Aggregator, aggregator
from drsplat.field.evidence.aggregation.entries import BLOCK_ROWS, canonical, column_counts, of_columns, with_weights
from drsplat.field.evidence.aggregation.outliers import OutlierRejection
from drsplat.field.evidence.aggregation.trust import MaskTrust, tally
from drsplat.field.evidence.aggregation.voting import effective_views, reliability, resultant_lengths
from drsplat.field.evidence.evidence import Evidence, MaskIds
from fields import random_weights, unit_rows

few = settings(derandomize=True, max_examples=25)
seeds = st.integers(0, 2**32)
WEIGHERS = [a for a in MEASURED.values() if a.voting is None]
every_weigher = pytest.mark.parametrize("how", WEIGHERS, ids=lambda a: a.name)


def evidence_of(rng: np.random.Generator, rows: int = 60, views: int = 7, per_view: int = 3, dim: int = 16) -> Evidence:
    """Rows see some masks of each view, of weights from a hundredth of a pixel to a hundred pixels.

    Masks are of three things, so that most agree with some and disagree with others.
    """
    columns = views * per_view
    pattern = random_weights(rng, rows, columns, 0.35)
    weights = np.exp(rng.normal(0, 2, len(pattern.data))).astype(np.float32)
    matrix = csr_array((weights, pattern.indices, pattern.indptr), shape=pattern.shape)
    things = unit_rows(rng, 3, dim)[rng.integers(0, 3, columns)]
    embeddings = things + 0.5 * unit_rows(rng, columns, dim)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    names = tuple(f"{i:02d}.jpg" for i in range(views))
    view = np.repeat(np.arange(views, dtype=np.int32), per_view)
    ids = np.tile(np.arange(per_view, dtype=np.int32), views)
    return Evidence(matrix, MaskIds(names, view, ids), embeddings)


def one_row(weights: list[float], embeddings: list[list[float]]) -> Evidence:
    """One Gaussian, one mask per view."""
    count = len(weights)
    rows = np.array(embeddings, float)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    matrix = csr_array(np.float32([weights]))
    views = np.arange(count, dtype=np.int32)
    names = tuple(f"{i:02d}.jpg" for i in range(count))
    masks = MaskIds(names, views, np.zeros(count, np.int32))
    return Evidence(matrix, masks, rows.astype(np.float32))


def features(how: Callable[[Evidence, int], Evidence] | Aggregator, evidence: Evidence):
    if isinstance(how, Aggregator):
        return how(evidence).features(0, len(evidence))
    return how(evidence, 1).features(0, len(evidence))


def votes(evidence: Evidence, row: int) -> list[tuple[float, np.ndarray]]:
    """Weight and embedding, in order."""
    part = slice(*evidence.weights.indptr[row : row + 2])
    columns = evidence.weights.indices[part]
    return list(zip(evidence.weights.data[part].astype(float), evidence.embeddings[columns].astype(float), strict=True))


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(np.linalg.norm(vector), 1e-300)


def slow_margins(evidence: Evidence, row: int, deviations: float, least: float) -> np.ndarray:
    """How far above the limit each vote is: those below 0 go."""
    cast = votes(evidence, row)
    if len(cast) < 3:
        return np.ones(len(cast))

    def weighted_median(values: list[float]) -> float:
        held, half = 0.0, sum(w for w, _ in cast) / 2
        for i in np.argsort(values, kind="stable"):
            held += cast[i][0]
            if held >= half:
                return values[i]
        raise AssertionError

    agree = []
    for i, (_, f) in enumerate(cast):
        rest = sum(w * e for j, (w, e) in enumerate(cast) if j != i)
        agree.append(float(f @ unit(np.asarray(rest))))
    middle = weighted_median(agree)
    spread = 1.4826 * weighted_median([abs(a - middle) for a in agree])
    return np.array(agree) - (middle - max(least, deviations * spread))


@pytest.mark.slow
@few
@given(seeds, st.sampled_from([(3.0, 0.05), (1.0, 0.0), (2.0, 0.3)]))
def test_the_inliers_are_those_of_the_twin(seed, limits):
    evidence = evidence_of(default_rng(seed))
    kept = OutlierRejection(*limits)(evidence, 1).weights
    dropped = 0
    for row in range(len(evidence)):
        stays = np.isin(evidence.weights[[row]].indices, kept[[row]].indices)
        margins = slow_margins(evidence, row, *limits)
        clear = np.abs(margins) > 1e-3  # what agrees with one heavy vote alone is a small difference of float32 sums
        assert_array_equal(stays[clear], margins[clear] > 0)
        dropped += np.count_nonzero(~stays)
    assert dropped > 10  # or the test shows nothing


def slow_trust(evidence: Evidence, sharpness: float) -> np.ndarray:
    """Weights, dense; mask by mask and row by row."""
    weights = evidence.weights.toarray().astype(float)
    e = evidence.embeddings.astype(float)
    rows, masks = weights.shape
    agreement, level = np.zeros(weights.shape), np.zeros(rows)
    for i in range(rows):
        for j in np.flatnonzero(weights[i]):
            whole = weights[i] @ e
            rest = whole - weights[i, j] * e[j]
            alone = np.linalg.norm(rest) <= 1e-3 * np.linalg.norm(whole)
            agreement[i, j] = 1 if alone else e[j] @ rest / np.linalg.norm(rest)
        if weights[i].any():
            level[i] = (weights[i] * agreement[i]).sum() / weights[i].sum()
    trust = np.ones(masks)
    for j in range(masks):
        held = np.flatnonzero(weights[:, j])
        if len(held):
            surplus = agreement[held, j] - level[held]
            trust[j] = np.exp(sharpness * np.average(surplus, weights=weights[held, j]))
    changed = np.zeros(weights.shape)
    for i in range(rows):
        for view in range(len(evidence.masks.view_names)):
            of = (evidence.masks.views == view) & (weights[i] > 0)
            if of.any():
                changed[i, of] = weights[i, of] * np.average(trust[of], weights=weights[i, of])
    return changed


@few
@given(seeds, st.sampled_from([0.5, 4.0]))
def test_trust_is_that_of_the_twin(seed, sharpness):
    evidence = evidence_of(default_rng(seed))
    found = MaskTrust(sharpness)(evidence, 1).weights.toarray()
    # Agreements are float32: where a vote outweighs its row a thousandfold, little is left of the rest.
    assert_allclose(found, slow_trust(evidence, sharpness), rtol=2e-3)


def test_parts_of_rows_add_up_to_the_whole_to_the_bit():
    """In any order, as tasks of many processes come to an end; sums of floats would not."""
    evidence = evidence_of(default_rng(8), rows=300)
    order = default_rng(9).permutation(300)
    whole, parts = tally(evidence), [tally(evidence.rows(rows)) for rows in np.array_split(order, 7)]
    for which in (0, 1):
        assert_array_equal(whole[which], np.sum([part[which] for part in parts], axis=0))
    trust = MaskTrust().trust(whole)
    rows = np.sort(order[:40])
    of_whole = MaskTrust().weighed(evidence, trust).rows(rows)
    assert_array_equal(of_whole.weights.data, MaskTrust().weighed(evidence.rows(rows), trust).weights.data)


def test_chunks_of_rows_do_not_show_in_trust(monkeypatch):
    evidence = evidence_of(default_rng(5), rows=200)
    whole = MaskTrust()(evidence, 1).weights.data
    for module in ("entries", "trust"):
        monkeypatch.setattr(f"drsplat.field.evidence.aggregation.{module}.PASS_ENTRIES", 37)
    assert_allclose(MaskTrust()(evidence, 1).weights.data, whole, rtol=1e-6)


@few
@given(seeds)
def test_the_entries_of_some_columns(seed):
    rng = default_rng(seed)
    evidence = evidence_of(rng)
    weights, kept = evidence.weights, rng.random(evidence.weights.shape[1]) < 0.5
    weights.data[rng.random(weights.nnz) < 0.1] = 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drsplat.field.evidence.aggregation.entries.PASS_ENTRIES", int(rng.integers(1, 200)))
        found, counts = of_columns(evidence, kept).weights, column_counts(weights)
    whole = with_weights(evidence, np.where(kept[weights.indices], weights.data, np.float32(0))).weights
    for name in ("indptr", "indices", "data"):
        assert_array_equal(getattr(found, name), getattr(whole, name), strict=True)
    assert_array_equal(counts, np.bincount(weights.indices, minlength=len(kept)))


def test_reliability_by_hand():
    matrix = np.float32([[2, 2, 0], [3, 0, 0], [1, 0, 1], [0, 0, 0], [1, 1, 2]])
    masks = MaskIds(("a", "b"), np.int32([0, 0, 1]), np.int32([0, 1, 0]))
    embeddings = np.float32([[1, 0], [0, 1], [1, 0]])
    evidence = Evidence(csr_array(matrix), masks, embeddings)
    assert_allclose(effective_views(evidence), [1, 1, 2, 0, 2])  # the views see 2 and 2 of the last
    lengths = [0.5**0.5, 1, 1, 0, (9 + 1) ** 0.5 / 4]
    assert_allclose(resultant_lengths(evidence), lengths, atol=1e-6)
    assert_allclose(reliability(evidence), np.multiply(lengths, [1 / 2, 1 / 2, 2 / 3, 0, 2 / 3]), atol=1e-6)


def test_the_mean_is_the_papers_to_the_bit():
    evidence = evidence_of(default_rng(2))
    for name in ("mean", "official", "centre-pixel"):
        ours = MEASURED[name](evidence)
        assert ours.evidence is evidence
        assert_array_equal(ours.features(3, 50), evidence.features(3, 50))


@pytest.mark.slow
@few
@given(seeds)
def test_of_one_view_and_mask_all_are_the_mean(seed):
    """Gates and pruning may drop a vote, but what is left is the only one."""
    evidence = evidence_of(default_rng(seed), views=1, per_view=1)
    mean = features(aggregator("mean"), evidence)
    for how in WEIGHERS:
        ours = features(how, evidence)
        kept = ours.any(axis=1)
        assert_allclose(ours[kept], mean[kept], atol=1e-6)
        assert kept.any()


@every_weigher
def test_the_order_in_which_views_come_does_not_matter(how):
    evidence, rng = evidence_of(default_rng(3)), default_rng(4)
    order = rng.permutation(len(evidence.masks))
    renamed = rng.permutation(len(evidence.masks.view_names))
    names = tuple(evidence.masks.view_names[i] for i in np.argsort(renamed))
    masks = MaskIds(names, renamed[evidence.masks.views[order]].astype(np.int32), evidence.masks.ids[order])
    columns = csr_array(evidence.weights[:, order])
    columns.sort_indices()  # or the entries of a row would still come in the old order
    shuffled = Evidence(columns, masks, evidence.embeddings[order])
    assert shuffled.masks.view_names != evidence.masks.view_names
    ours, expected = features(how, shuffled), features(how, evidence)
    if how.steps:
        assert_array_equal(ours, expected)
    else:  # the mean adds up in the order given
        assert_allclose(ours, expected, atol=1e-6)


def test_canonical_evidence_is_left_alone():
    evidence = evidence_of(default_rng(5))
    assert canonical(evidence) is evidence


@pytest.mark.slow
@few
@given(seeds)
def test_no_rule_adds_a_vote(seed):
    evidence = evidence_of(default_rng(seed))
    there = evidence.weights.toarray() > 0
    for how in WEIGHERS:
        weighed = how(evidence).evidence.weights
        assert not (weighed.toarray() > 0)[~there].any()
        assert (weighed.data > 0).all()


def test_two_votes_have_no_majority():
    evidence = one_row([9, 1], [[1, 0], [0, 1]])
    assert OutlierRejection(0.0, 0.0)(evidence).weights.nnz == 2


@every_weigher
def test_any_number_of_threads_gives_the_same_bits(how):
    evidence = evidence_of(default_rng(7), rows=BLOCK_ROWS + 700)
    one = how(evidence, threads=1).evidence.weights
    for threads in (2, 3):
        other = how(evidence, threads=threads).evidence.weights
        assert_array_equal(one.data, other.data)
        assert_array_equal(one.indices, other.indices)


@pytest.mark.slow
@every_weigher
def test_blocks_do_not_show(how, monkeypatch):
    from drsplat.field.evidence.aggregation import entries

    evidence = evidence_of(default_rng(8), rows=300)
    whole = how(evidence).evidence.weights
    for name, size in (("BLOCK_ROWS", 32), ("BLOCK_CELLS", 40)):
        monkeypatch.setattr(entries, name, size)
        assert_array_equal(how(evidence).evidence.weights.toarray(), whole.toarray())


@every_weigher
def test_evidence_without_any_weight_stays_so(how):
    evidence = evidence_of(default_rng(9))
    empty = replace(evidence, weights=csr_array(evidence.weights.shape, dtype=np.float32))
    ours = how(empty)
    assert not ours.present.any()
    assert not ours.features(0, len(empty)).any()


def test_names():
    assert all(name == how.name for name, how in AGGREGATORS.items())
    with pytest.raises(InputError, match=r"'best': there are mean, official, inliers, trusted, robust$"):
        aggregator("best")
    assert aggregator("inliers").parameters == {"OutlierRejection.deviations": 3.0, "OutlierRejection.least": 0.05}
