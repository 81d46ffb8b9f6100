"""Where photos are looked at, and what registrations, fields and the command line make of aggregators."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.aggregation import CENTRES, MEAN_RECORD, AggregatorRecord, Sampling, aggregator
from drsplat.aggregation import sampling as sampling_module
from drsplat.aggregation.sampling import centre_pixels, centre_weights
from drsplat.errors import FormatError, InputError, MismatchError
from drsplat.field import load_field
from drsplat.formats.checksums import sealed
from drsplat.kernels import reference, splat_arrays, view_weights
from drsplat.registration import Registration, register
from fields import toy_field
from scenes import random_gaussians, random_segment_map
from test_registration import capture, named_view, same

few = settings(derandomize=True, deadline=None, max_examples=8)


@pytest.fixture(scope="module")
def gaussians():
    return random_gaussians(400, seed=3)


def slow_centre_weights(arrays, view, segment_ids) -> dict[int, tuple[int, float]]:
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
        if len(here) and segment_ids[row, column] >= 0:
            weight = float(contributions.weights[row, column, here[0]])
            found[i] = int(segment_ids[row, column]), weight
    return found


@few
@given(st.integers(0, 10**6))
def test_centre_weights_are_those_of_the_twin(seed: int) -> None:
    arrays, view = splat_arrays(random_gaussians(250, seed=seed)), named_view(seed % 7)
    segment_ids = random_segment_map(view.height, view.width, 6, seed=seed)
    expected = slow_centre_weights(arrays, view, segment_ids)
    ours = centre_weights(arrays, view, segment_ids)
    assert_array_equal(ours.gaussian_ids, sorted(expected))
    assert len(expected) > 10
    assert_array_equal(ours.segment_ids, [expected[i][0] for i in ours.gaussian_ids])
    assert_allclose(ours.weights, [expected[i][1] for i in ours.gaussian_ids], atol=2e-5)


def test_centre_weights_do_not_depend_on_how_many_pixels_are_looked_at_at_once(
    gaussians, monkeypatch
) -> None:
    arrays, view = splat_arrays(gaussians), named_view(1)
    segment_ids = random_segment_map(view.height, view.width, 6, seed=0)
    whole = centre_weights(arrays, view, segment_ids)
    monkeypatch.setattr(sampling_module, "PIXELS_AT_ONCE", 7)
    for a, b in zip(whole, centre_weights(arrays, view, segment_ids, threads=3), strict=True):
        assert_array_equal(a, b)


def test_a_centre_adds_no_more_than_its_mask_sees_of_it(gaussians) -> None:
    arrays, view = splat_arrays(gaussians), named_view(2)
    segment_ids = random_segment_map(view.height, view.width, 6, seed=1)
    total = {
        (i, s): w for i, s, w in zip(*view_weights(arrays, view, segment_ids, None), strict=True)
    }
    for i, s, w in zip(*centre_weights(arrays, view, segment_ids), strict=True):
        assert w <= total[i, s] * (1 + 1e-5)
        assert w <= arrays.opacities[i]


def test_what_is_behind_or_outside_has_no_pixel(gaussians) -> None:
    arrays, view = splat_arrays(gaussians), named_view(0)
    pixels = centre_pixels(arrays, view)
    assert (pixels == -1).any()
    turned = view.cam_from_world.copy()
    turned[:3] = np.diag([-1, 1, -1]) @ turned[:3]
    assert (centre_pixels(arrays, replace(view, cam_from_world=turned)) == -1).all()


def test_a_map_without_segments_gives_no_centre(gaussians) -> None:
    view = named_view(0)
    nothing = np.full((view.height, view.width), -1, np.int32)
    assert not len(centre_weights(splat_arrays(gaussians), view, nothing).weights)


def test_registering_centres(gaussians) -> None:
    views, features = capture()
    ours = register(gaussians, views, features, sampling=CENTRES)
    arrays = splat_arrays(gaussians)
    for i, view in enumerate(views):
        mine = ours.weights[:, ours.segments.views == i].tocoo()
        expected = centre_weights(arrays, view, features[f"{i:03d}"].segment_ids)
        assert mine.nnz == len(expected.weights)
        assert_array_equal(
            mine.toarray()[expected.gaussian_ids, expected.segment_ids], expected.weights
        )
    assert (ours.weights > 0).sum(axis=1).max() <= len(views)
    field = ours.to_field(aggregator="centre-pixel")
    assert field.aggregator == AggregatorRecord("centre-pixel", {}, replace(CENTRES, near=0.2))
    gated = ours.to_field(aggregator="vala")
    assert 0 < len(gated) < len(field)


def test_parts_of_centres_are_not_those_of_masks(gaussians, tmp_path: Path) -> None:
    views, features = capture(1)
    register(gaussians, views, features, topk=None, parts=tmp_path)
    centres = register(gaussians, views, features, sampling=CENTRES, parts=tmp_path)
    assert same(centres, register(gaussians, views, features, sampling=CENTRES))


def test_the_published_code_is_one_word_away(gaussians) -> None:
    views, features = capture()
    how = aggregator("official")
    ours = register(gaussians, views, features, sampling=how.sampling)
    assert same(ours, register(gaussians, views, features, 45, first_hits=100))
    field = ours.to_field(aggregator="official")
    assert field.fingerprint == ours.to_field().fingerprint
    assert field.aggregator.sampling == Sampling(45, 100, near=0.2)


def test_an_aggregator_for_another_sampling_is_refused(gaussians) -> None:
    views, features = capture()
    plain = register(gaussians, views, features)
    assert plain.sampling == Sampling(40, near=0.2)
    for name in ("official", "centre-pixel", "vala"):
        with pytest.raises(MismatchError, match=rf"aggregator\('{name}'\)\.sampling to register"):
            plain.to_field(aggregator=name)
    with pytest.raises(MismatchError, match="unknown sampling"):
        replace(plain, sampling=None).to_field(aggregator="official")
    with pytest.raises(MismatchError, match="pass those registered"):
        plain.to_field(aggregator="robust", gaussians=random_gaussians(400, seed=4))
    with pytest.raises(MismatchError, match="in the same way"):
        plain.merged(register(gaussians, views, features, topk=3))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (Sampling(40).__dict__ | {"topk": 0}, "topk"),
        ({"topk": 3, "first_hits": -1}, "first_hits"),
        ({"topk": 3, "pixels": "centre"}, "leave topk"),
        ({"near": 0.0}, "in front of the camera"),
        ({"near": float("nan")}, "in front of the camera"),
    ],
)
def test_samplings_that_make_no_sense_are_refused(given: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Sampling(**given)


def test_a_field_remembers_what_made_it(gaussians, tmp_path: Path) -> None:
    views, features = capture()
    registration = register(gaussians, views, features, topk=10)
    field = registration.to_field(aggregator="robust", gaussians=gaussians)
    field.save(tmp_path / "a.field")
    again = load_field(tmp_path / "a.field")
    assert again.aggregator == field.aggregator
    assert again.aggregator.name == "robust"
    assert again.aggregator.parameters["ModeVoting.neighbours"] == 20
    assert again.aggregator.sampling == Sampling(10, near=0.2)
    back = Registration.from_field(again)
    assert back.sampling == Sampling(10, near=0.2)
    assert back.to_field().fingerprint == registration.to_field().fingerprint


def test_fields_of_older_versions_are_of_means(tmp_path: Path) -> None:
    manifest = saved_manifest(tmp_path)
    assert manifest.pop("aggregator")["name"] == "mean"
    write_manifest(tmp_path, manifest)
    assert load_field(tmp_path / "a.field").aggregator == MEAN_RECORD


@pytest.mark.parametrize(
    "bad",
    [
        "mean",
        [],
        {},
        {"name": 3, "parameters": {}},
        {"name": "mean"},
        {"name": "mean", "parameters": []},
        {"name": "mean", "parameters": {"a": "b"}},
        {"name": "mean", "parameters": {"a": True}},
        {"name": "mean", "parameters": {"a": float("nan")}},
        {"name": "mean", "parameters": {}, "sampling": 3},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 1.5, "pixels": "all"}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": True, "pixels": "all"}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 0, "pixels": "all"}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 3, "pixels": ["all"]}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 3}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 3, "pixels": "centre"}},
    ],
)
def test_a_damaged_record_is_refused(bad: object, tmp_path: Path) -> None:
    write_manifest(tmp_path, saved_manifest(tmp_path) | {"aggregator": bad})
    with pytest.raises(FormatError, match=r"a\.field"):
        load_field(tmp_path / "a.field")


def saved_manifest(folder: Path) -> dict:
    toy_field().save(folder / "a.field")
    return json.loads((folder / "a.field" / "field.json").read_text())


def write_manifest(folder: Path, manifest: dict) -> None:
    (folder / "a.field" / "field.json").write_text(json.dumps(sealed(manifest)))
