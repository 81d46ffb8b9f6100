"""Aggregators on a furnished room, where the thing behind every Gaussian is known, with some wrong labels."""

import numpy as np
import pytest
from benchmarks.suite.aggregators import MEASURED
from test_cli import answer_of, error_of, registering, text_of

from drsplat import WordEncoder, load_field
from drsplat.field.evidence.aggregation import Aggregated, aggregator
from drsplat.field.evidence.evidence import Evidence
from drsplat.field.registration import Registration

NOISE, BLOCK = 0.5, 4096


@pytest.fixture(scope="module")
def registration(story) -> Registration:
    return Registration.from_field(story.field)


def mislabelled(registration: Registration, story, share: float) -> Evidence:
    """A share of the masks says what another thing would say."""
    evidence, rng = registration.evidence, np.random.default_rng(0)
    things = WordEncoder().encode_texts(story.room.names)
    count = len(evidence.masks)
    wrong = things[rng.integers(0, len(things), count)]
    noise = rng.standard_normal(wrong.shape)
    wrong = wrong + NOISE * noise / np.linalg.norm(noise, axis=1, keepdims=True)
    wrong /= np.linalg.norm(wrong, axis=1, keepdims=True)
    swapped = np.where(rng.random((count, 1)) < share, wrong, evidence.embeddings)
    return Evidence(evidence.weights, evidence.masks, swapped.astype(np.float32))


def accuracy(features: Aggregated, story) -> float:
    """Share of Gaussians whose feature is nearest to the words of their own thing."""
    things, right = WordEncoder().encode_texts(story.room.names), 0
    for begin in range(0, len(features), BLOCK):
        labels = story.room.labels[begin : begin + BLOCK]
        found = features.features(begin, begin + len(labels))
        right += int((found.any(axis=1) & ((found @ things.T).argmax(axis=1) == labels)).sum())
    return right / len(features)


def test_robust_loses_little_where_all_labels_are_right(story, registration):
    mean, robust = (
        accuracy(aggregator(name)(registration.evidence, story.gaussians), story) for name in ("mean", "robust")
    )
    assert mean > 0.85
    assert robust > mean - 0.005  # neighbours across an edge lend a few features wrongly


@pytest.mark.slow
@pytest.mark.parametrize(("share", "gain"), [(0.2, 0.025), (0.4, 0.08)])
def test_robust_is_better_the_more_labels_are_wrong(share, gain, story, registration):
    evidence = mislabelled(registration, story, share)
    named = {
        name: accuracy(MEASURED[name](evidence, story.gaussians), story)
        for name in ("mean", "tempered", "trusted", "robust")
    }
    assert named["robust"] > named["mean"] + gain
    assert named["trusted"] > named["tempered"] > named["mean"] + gain / 2


@pytest.mark.slow
def test_the_command_takes_an_aggregator_by_name(story, demo_folder, tmp_path, capsys):
    output = tmp_path / "a.field"
    answer = answer_of(
        capsys, *registering(demo_folder, output), "--aggregator", "robust", "--topk", "20",
        "--subvectors", "16",
    )  # fmt: skip
    assert (answer["aggregator"], answer["topk"]) == ("robust", 20)
    made = load_field(output).aggregator
    assert made.name == "robust"
    assert made.sampling.topk == 20
    assert "robust" in text_of(capsys, "inspect", output)


def test_the_command_refuses_what_an_aggregator_is_not(story, demo_folder, tmp_path, capsys):
    command = [*registering(demo_folder, tmp_path / "a.field"), "--aggregator"]
    assert "no aggregator 'best': there are mean" in error_of(capsys, *command, "best")
    assert "no aggregator 'vala'" in error_of(capsys, *command, "vala")
    for option in ("--topk", "--first-hits"):
        said = error_of(capsys, *command, "official", option, "30")
        assert f"--aggregator official has its own {option}" in said
