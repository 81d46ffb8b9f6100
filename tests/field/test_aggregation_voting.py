"""Neighbours' votes against a slow twin."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from test_aggregation import evidence_of

from drsplat.errors import MismatchError
from drsplat.field import build_field
from drsplat.field.evidence.aggregation import Aggregated, Aggregator, aggregator
from drsplat.field.evidence.aggregation.voting import SUPPORT_TOLERANCE, ModeVoting, reliability
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.gaussians import Gaussians
from refusing import refused
from scenes import random_gaussians

VOTING = Aggregator("voting", voting=ModeVoting())
few = settings(derandomize=True, max_examples=15)


def slow_donors(voting: ModeVoting, evidence: Evidence, gaussians: Gaussians, receivers: np.ndarray) -> np.ndarray:
    """Row by row, pair by pair."""
    trust, means = reliability(evidence), gaussians.means.astype(float)
    features = evidence.features(0, len(evidence)).astype(float)
    sides = np.sort(gaussians.scales.astype(float), axis=1)
    size = sides[:, 1] * sides[:, 2]
    donors = np.where(trust > 0, np.arange(len(evidence)), -1)
    givers = np.flatnonzero(trust > 0)
    for i in receivers:
        distance = np.linalg.norm(means[givers] - means[i], axis=1)
        order = np.lexsort((givers, distance))[: voting.neighbours + 1]
        near, d = givers[order], distance[order]
        close = np.exp(-0.5 * (d / d[len(d) // 2]) ** 2)
        close *= np.minimum(1, size[near] / size[i]) ** voting.footprint
        support = {}
        for j in near:
            alike = np.exp((features[near] @ features[j] - 1) / voting.bandwidth)
            support[j] = trust[j] * (trust[near] * close * alike).sum()
        best = max(near, key=lambda j: support[j])
        if support[best] > (1 + voting.margin) * (1 + SUPPORT_TOLERANCE) * support.get(i, 0.0):
            donors[i] = best
    return donors


def test_who_is_elected_does_not_depend_on_who_else_is_asked():
    """To the bit: support too, which BLAS would sum in other orders for other receivers."""
    rng, voting = default_rng(4), ModeVoting()
    evidence, gaussians = evidence_of(rng, rows=400), random_gaussians(400, 4)
    whole = voting.donors(evidence, gaussians, np.arange(400))
    assert (whole != np.arange(400)).any()
    for rows in np.array_split(rng.permutation(400), 9):
        assert_array_equal(voting.donors(evidence, gaussians, rows)[rows], whole[rows])


@few
@given(
    st.integers(0, 2**32), st.sampled_from([ModeVoting(), ModeVoting(5, 0.3, 0.0, 0.5), ModeVoting(200, 0.1, 0.2, 0.0)])
)
def test_donors_are_those_of_the_twin(seed, voting):
    rng = default_rng(seed)
    evidence, gaussians = evidence_of(rng, rows=90), random_gaussians(90, seed % 1000)
    sparse = evidence.weights.toarray()
    sparse[rng.random(90) < 0.2] = 0
    evidence = replace(evidence, weights=csr_array(sparse))
    receivers = np.flatnonzero(rng.random(90) < 0.8)
    ours = voting.donors(evidence, gaussians, receivers)
    assert_array_equal(ours, slow_donors(voting, evidence, gaussians, receivers))
    assert (ours != np.arange(90)).any()


def two_groups(*, flipped: int) -> tuple[Evidence, Gaussians]:
    """Forty Gaussians of thing 0 and forty of thing 1, far apart; the first `flipped` say the other."""
    gaussians = random_gaussians(80, seed=2)
    means = gaussians.means.copy()
    means[40:] += 100
    says = np.repeat([0, 1], 40)
    says[:flipped] = 1
    weights = np.zeros((80, 4), np.float32)
    weights[np.arange(80), says] = weights[np.arange(80), says + 2] = 1
    masks = MaskIds(("a", "b"), np.int32([0, 0, 1, 1]), np.array([0, 1, 0, 1], "i4"))
    embeddings = np.eye(8, dtype=np.float32)[[0, 1, 0, 1]]
    alike = np.ones((80, 3), np.float32)
    return Evidence(csr_array(weights), masks, embeddings), replace(gaussians, means=means, scales=alike)


def test_one_of_many_at_one_place_still_counts_itself():
    """More coincident Gaussians than neighbours: a row may be missing from what the tree finds."""
    evidence, gaussians = two_groups(flipped=0)
    gaussians = replace(gaussians, means=np.zeros((80, 3), np.float32))
    donors = ModeVoting(4, margin=1e6).donors(evidence, gaussians, np.arange(80))
    assert_array_equal(donors, np.arange(80))


def test_what_lost_all_votes_gets_a_neighbours_feature_and_what_had_none_does_not():
    evidence, gaussians = two_groups(flipped=0)
    dense = evidence.weights.toarray()
    dense[5] = 0
    weighed = replace(evidence, weights=csr_array(dense))
    donors = ModeVoting().donors(weighed, gaussians, np.array([5]))
    assert 0 <= donors[5] < 40
    assert ModeVoting().donors(weighed, gaussians, np.array([6]))[5] == -1
    voted = VOTING(weighed, gaussians)
    assert not voted.present[5]
    assert voted.present.sum() == 79
    assert not voted.features(5, 6).any()


def test_no_evidence_gives_no_donor():
    evidence, gaussians = two_groups(flipped=0)
    empty = replace(evidence, weights=csr_array((80, 4), dtype=np.float32))
    assert not aggregator("robust")(empty, gaussians).present.any()


def test_any_number_of_threads_gives_the_same_donors():
    evidence, gaussians = (evidence_of(default_rng(0), rows=1500), random_gaussians(1500, seed=1))
    first, *others = (aggregator("robust")(evidence, gaussians, threads=threads) for threads in (1, 2, 3))
    for other in others:
        assert_array_equal(first.donors, other.donors)
        assert_array_equal(first.features(0, 1500), other.features(0, 1500, threads=2))


def test_features_of_donors_row_by_row():
    evidence = evidence_of(default_rng(1))
    donors = default_rng(2).integers(-1, 60, 60).astype(np.int32)
    voted, own = Aggregated(evidence, donors), evidence.features(0, 60)
    own[np.diff(evidence.weights.indptr) == 0] = 0
    expected = np.where(donors[:, None] >= 0, own[donors], 0)
    assert_array_equal(voted.features(0, 60), expected)
    assert_array_equal(voted.features(10, 25), expected[10:25])
    index = np.array([7, 3, 3, 59])
    assert_array_equal(voted.rows(index).features(0, 4), expected[index])
    assert_array_equal(voted.present, expected.any(axis=1))


def test_a_field_of_donors_keeps_everyones_own_evidence():
    evidence, gaussians = two_groups(flipped=3)
    voted = aggregator("robust")(evidence, gaussians)
    encoder = EncoderIdentity("e", 8)
    field = build_field(evidence, gaussians.fingerprint, encoder, aggregated=voted)
    assert np.shares_memory(field.evidence.weights.data, evidence.weights.data)
    scores = field.scores(np.eye(8, dtype=np.float32)[0])
    assert_allclose(scores, np.repeat([1, 0], 40), atol=1e-3)
    assert [e.mask_id for e in field.explain(0, np.eye(8, dtype=np.float32)[1])] == [1, 1]


def test_voting_needs_the_gaussians_of_the_rows():
    evidence, gaussians = two_groups(flipped=0)
    with refused("'voting' looks at neighbouring Gaussians"):
        VOTING(evidence)
    with pytest.raises(MismatchError, match="79 Gaussians for evidence of 80"):
        VOTING(evidence, gaussians.subset(np.arange(79)))
    with refused("79 features for evidence of 80"):
        build_field(
            evidence, "s", EncoderIdentity("e", 8), aggregated=aggregator("mean")(evidence.rows(np.arange(79)))
        )  # fmt: skip
