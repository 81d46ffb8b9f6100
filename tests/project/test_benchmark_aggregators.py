"""Aggregators of the benchmark that are not in the product: each rule against a slow twin, or by hand."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.suite.aggregators import MEASURED, centres
from benchmarks.suite.aggregators.centres import CentrePixels, centre_weights
from benchmarks.suite.aggregators.gates import Gated, MassGate, QuantileGate, Spared, view_sums
from benchmarks.suite.aggregators.medians import CosineMedian
from benchmarks.suite.aggregators.pruning import Pruned
from benchmarks.suite.aggregators.tempering import Tempered
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from test_aggregation import evidence_of, features, few, one_row, seeds, unit, votes
from test_registration import capture, named_view, same

from drsplat.errors import MismatchError
from drsplat.field import load_field
from drsplat.field.evidence.aggregation import AggregatorRecord, Sampling, aggregator
from drsplat.field.evidence.aggregation.outliers import OutlierRejection
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.registration import Registration, register
from drsplat.kernels import splat_arrays
from refusing import refused
from scenes import random_gaussians, random_mask_map
from twins import registering as reference

some = settings(derandomize=True, max_examples=8)


@pytest.fixture(scope="module")
def gaussians():
    return random_gaussians(400, seed=3)


def slow_median(evidence: Evidence, row: int) -> np.ndarray:
    z, total = np.zeros(evidence.dim), 0.0
    for weight, f in votes(evidence, row):
        eta = weight / (total + weight)
        z = unit(f) if total == 0 else unit(z + eta * (f - (f @ z) * z))
        total += weight
    return z


@few
@given(seeds)
def test_the_median_is_that_of_the_twin(seed):
    evidence = evidence_of(default_rng(seed))
    expected = [slow_median(evidence, row) for row in range(len(evidence))]
    assert_allclose(features(CosineMedian(), evidence), expected, atol=2e-5)


def test_the_mass_gate_by_hand():
    weights = np.array([5.0, 1, 3, 1, 0.1])  # 75 % of 10.1 are 5 and 3
    assert MassGate(0.75, 0.0).passes(weights).tolist() == [True, False, True, False, False]
    assert MassGate(0.8, 0.0).passes(weights).tolist() == [True, True, True, False, False]
    assert MassGate(1.0, 0.0).passes(weights).all()
    assert MassGate(1.0, 1.0).passes(weights).tolist() == [True] * 4 + [False]


def test_the_quantile_gate_by_hand():
    weights = np.arange(1.0, 12)  # the median is 6
    assert QuantileGate(0.5, 0.0).passes(weights).tolist() == [False] * 6 + [True] * 5
    assert QuantileGate(0.5, 9.0).passes(weights).tolist() == [False] * 9 + [True] * 2


@few
@given(seeds)
def test_view_sums_are_those_of_the_dense_matrix(seed):
    evidence = evidence_of(default_rng(seed), per_view=4)
    sums, views = view_sums(evidence), evidence.masks.views
    dense = np.zeros((len(evidence), views.max() + 1))
    dense[sums.rows, sums.views] = sums.weights
    expected = [evidence.weights.toarray()[:, views == v].sum(axis=1) for v in range(views.max() + 1)]
    assert_allclose(dense, np.transpose(expected), rtol=1e-6)
    assert sums.entries.sum() == evidence.weights.nnz


@few
@given(seeds)
def test_gates_look_at_each_view_alone(seed):
    evidence = evidence_of(default_rng(seed))
    gates = MassGate(), QuantileGate(0.4)
    kept = Gated(gates)(evidence).weights.toarray()
    dense, views = evidence.weights.toarray().astype(float), evidence.masks.views
    for view in range(len(evidence.masks.view_names)):
        mine = dense[:, views == view]
        seen = np.flatnonzero(mine.sum(axis=1))
        totals = mine[seen].sum(axis=1)
        passed = seen[gates[0].passes(totals) & gates[1].passes(totals)]
        expected = np.where(np.isin(np.arange(len(mine)), passed)[:, None], mine, 0)
        assert_allclose(kept[:, views == view], expected)
    spared, left = Spared(Gated(gates))(evidence).weights.toarray(), kept.any(axis=1)
    assert_allclose(spared, np.where(left[:, None], kept, dense))  # a row that no photo would keep is left as it was


def test_rows_of_hardly_any_weight_are_pruned():
    matrix = csr_array(np.array([[2, 2], [0.03, 0], [0.05, 0], [4, 1], [0, 0]], np.float32))
    masks = MaskIds(("a",), np.zeros(2, np.int32), np.arange(2, dtype=np.int32))
    evidence = Evidence(matrix, masks, np.eye(2, dtype=np.float32))
    pruned = Pruned(share=0.02)(evidence).weights  # the median of 0.03, 0.05, 4 and 5 is 2.025
    assert (np.diff(pruned.indptr) > 0).tolist() == [True, False, True, True, False]
    assert (np.diff(Pruned(1.0, 0.0)(evidence).weights.indptr) > 0).sum() == 2


def test_tempering_by_hand():
    evidence = one_row([9, 1], [[1, 0], [0, 1]])
    assert_allclose(features(Tempered(0.5), evidence), [[3 / 10**0.5, 1 / 10**0.5]], atol=1e-6)
    assert_allclose(features(Tempered(0.0), evidence), [[0.5**0.5, 0.5**0.5]], atol=1e-6)
    assert_allclose(features(Tempered(1.0), evidence), features(aggregator("mean"), evidence))


@few
@given(seeds, st.floats(0.01, 100))
def test_the_unit_of_weights_does_not_matter(seed, factor):
    """But where a gate has a floor, which is in pixels."""
    evidence = evidence_of(default_rng(seed))
    scaled = replace(evidence, weights=csr_array(evidence.weights * np.float32(factor)))
    for how in [
        CosineMedian(),
        Tempered(),
        OutlierRejection(),
        Gated((MassGate(0.75, 0.0), QuantileGate(0.4, 0.0))),
        Pruned(0.0),
    ]:
        assert_allclose(features(how, scaled), features(how, evidence), atol=1e-3)


def slow_centre_weights(arrays, view, mask_ids) -> dict[int, tuple[int, float]]:
    """Segment and weight of each Gaussian, from the twin's list of all contributors of each pixel."""
    contributions = reference.topk_contributions(arrays, view, len(arrays.opacities))
    found = {}
    for i, mean in enumerate(arrays.means.T.astype(float)):
        x, y, z = view.cam_from_world[:3] @ [*mean, 1]
        if z <= 0.2:
            continue
        column = int(np.floor(view.K[0, 0] * x / z + view.K[0, 2]))
        row = int(np.floor(view.K[1, 1] * y / z + view.K[1, 2]))
        if not (0 <= column < view.width and 0 <= row < view.height):
            continue
        here = np.flatnonzero(contributions.ids[row, column] == i)
        if len(here) and mask_ids[row, column] >= 0:
            weight = float(contributions.weights[row, column, here[0]])
            found[i] = int(mask_ids[row, column]), weight
    return found


@some
@given(st.integers(0, 10**6))
def test_centre_weights_are_those_of_the_twin(seed):
    arrays, view = splat_arrays(random_gaussians(250, seed=seed)), named_view(seed % 7)
    mask_ids = random_mask_map(view.height, view.width, 6, seed=seed)
    expected = slow_centre_weights(arrays, view, mask_ids)
    ours = centre_weights(arrays, view, mask_ids)
    assert_array_equal(ours.gaussian_ids, sorted(expected))
    assert len(expected) > 10
    assert_array_equal(ours.mask_ids, [expected[i][0] for i in ours.gaussian_ids])
    assert_allclose(ours.weights, [expected[i][1] for i in ours.gaussian_ids], atol=2e-5)


def test_centre_weights_do_not_depend_on_how_many_pixels_are_looked_at_at_once(gaussians, monkeypatch):
    arrays, view = splat_arrays(gaussians), named_view(1)
    mask_ids = random_mask_map(view.height, view.width, 6, seed=0)
    whole = centre_weights(arrays, view, mask_ids)
    monkeypatch.setattr(centres, "PIXELS_AT_ONCE", 7)
    for a, b in zip(whole, centre_weights(arrays, view, mask_ids, threads=3), strict=True):
        assert_array_equal(a, b)


def test_registering_centres(gaussians):
    views, features = capture()
    ours = register(gaussians, views, features, sampling=CentrePixels())
    arrays = splat_arrays(gaussians)
    for i, view in enumerate(views):
        mine = ours.weights[:, ours.masks.views == i].tocoo()
        expected = centre_weights(arrays, view, features[f"{i:03d}"].mask_ids)
        assert mine.nnz == len(expected.weights)
        assert_array_equal(mine.toarray()[expected.gaussian_ids, expected.mask_ids], expected.weights)
    assert (ours.weights > 0).sum(axis=1).max() <= len(views)
    field = ours.to_field(aggregator=MEASURED["centre-pixel"])
    assert field.aggregator == AggregatorRecord("centre-pixel", {}, CentrePixels(near=0.2))
    gated = ours.to_field(aggregator=MEASURED["vala"])
    assert 0 < len(gated) < len(field)


def test_parts_of_centres_are_not_those_of_masks(gaussians, tmp_path):
    views, features = capture(1)
    register(gaussians, views, features, sampling=Sampling(None), parts=tmp_path)
    ours = register(gaussians, views, features, sampling=CentrePixels(), parts=tmp_path)
    assert same(ours, register(gaussians, views, features, sampling=CentrePixels()))


def test_they_are_refused_for_what_was_looked_at_otherwise(gaussians):
    plain = register(gaussians, *capture())
    for name in ("centre-pixel", "vala"):
        with pytest.raises(MismatchError, match=r"pass sampling=CentrePixels\(.*\) to register"):
            plain.to_field(aggregator=MEASURED[name])
    with refused("leave topk"):
        CentrePixels(3)


def test_a_field_of_one_of_them_still_loads(gaussians, tmp_path):
    """The product has no such aggregator, and reads what it made: the mean can be had from it."""
    ours = register(gaussians, *capture(), sampling=CentrePixels())
    ours.to_field(aggregator=MEASURED["vala"]).save(tmp_path / "a.field")
    field = load_field(tmp_path / "a.field")
    assert (field.aggregator.name, field.aggregator.sampling.pixels) == ("vala", "centre")
    assert field.aggregator.parameters["MassGate.share"] == 0.75
    back = Registration.from_field(field)
    assert back.to_field().aggregator.name == "mean"
    with refused("only all of them can be registered, not 'centre'"):
        register(gaussians, *capture(), sampling=back.sampling)


def test_names():
    assert all(name == how.name for name, how in MEASURED.items())
    assert MEASURED["spared-gates"].parameters == MEASURED["gates"].parameters
    names = {"MassGate.share", "MassGate.floor", "QuantileGate.quantile", "QuantileGate.floor"}
    assert set(MEASURED["gates"].parameters) == names
    with refused("no aggregator 'vala'"):
        aggregator("vala")
