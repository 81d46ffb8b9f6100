"""Where photos are looked at, and what registrations, fields and the command line make of aggregators."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings
from test_registration import capture, same

from drsplat.errors import MismatchError
from drsplat.field import load_field
from drsplat.field.evidence.aggregation import Sampling, aggregator
from drsplat.field.registration import Registration, register
from drsplat.formats.tensors import sealed
from fields import toy_field
from refusing import malformed, refused
from scenes import random_gaussians

few = settings(derandomize=True, max_examples=8)


@pytest.fixture(scope="module")
def gaussians():
    return random_gaussians(400, seed=3)


def test_the_published_code_is_one_word_away(gaussians):
    views, features = capture()
    how = aggregator("official")
    ours = register(gaussians, views, features, sampling=how.sampling)
    assert same(ours, register(gaussians, views, features, Sampling(45, 100)))
    field = ours.to_field(aggregator="official")
    assert field.fingerprint == ours.to_field().fingerprint
    assert field.aggregator.sampling == Sampling(45, 100, near=0.2)


def test_an_aggregator_for_another_sampling_is_refused(gaussians):
    views, features = capture()
    plain = register(gaussians, views, features)
    assert plain.sampling == Sampling(40, near=0.2)
    with pytest.raises(MismatchError, match=r"sampling=Sampling\(topk=45, .*\) to register"):
        plain.to_field(aggregator="official")
    with pytest.raises(MismatchError, match="unknown sampling"):
        replace(plain, sampling=None).to_field(aggregator="official")
    with pytest.raises(MismatchError, match="pass those registered"):
        plain.to_field(aggregator="robust", gaussians=random_gaussians(400, seed=4))
    with pytest.raises(MismatchError, match="in the same way"):
        plain.merged(register(gaussians, views, features, sampling=Sampling(3)))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (Sampling(40).__dict__ | {"topk": 0}, "topk"),
        ({"topk": 3, "first_hits": -1}, "first_hits"),
        ({"near": 0.0}, "in front of the camera"),
        ({"near": float("nan")}, "in front of the camera"),
    ],
)
def test_samplings_that_make_no_sense_are_refused(given, said):
    with refused(said):
        Sampling(**given)


def test_a_field_remembers_what_made_it(gaussians, tmp_path):
    views, features = capture()
    registration = register(gaussians, views, features, sampling=Sampling(10))
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


@pytest.mark.parametrize(
    "bad",
    [
        "mean",
        [],
        {"name": 3, "parameters": {}},
        {"name": "mean", "parameters": []},
        {"name": "mean", "parameters": {"a": "b"}},
        {"name": "mean", "parameters": {"a": True}},
        {"name": "mean", "parameters": {"a": float("nan")}},
        {"name": "mean", "parameters": {}, "sampling": 3},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 1.5, "pixels": "all"}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": True, "pixels": "all"}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 0, "pixels": "all"}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 3, "pixels": ["all"]}},
        {"name": "mean", "parameters": {}, "sampling": {"topk": 3, "pixels": "some"}},
    ],
)
def test_a_damaged_record_is_refused(bad, tmp_path):
    write_manifest(tmp_path, saved_manifest(tmp_path) | {"aggregator": bad})
    with malformed(r"a\.field"):
        load_field(tmp_path / "a.field")


def saved_manifest(folder: Path) -> dict:
    toy_field().save(folder / "a.field")
    return json.loads((folder / "a.field" / "field.json").read_text())


def write_manifest(folder: Path, manifest: dict) -> None:
    (folder / "a.field" / "field.json").write_text(json.dumps(sealed(manifest)))
