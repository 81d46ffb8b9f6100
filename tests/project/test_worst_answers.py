"""Answers to words in the benchmark: what they are scored by, and what makes the worst of them bad."""

import doctest
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks import study_worst
from benchmarks.suite import answers, causes, numbers, reading, stamps, tables
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array

from drsplat import Gaussians, View
from drsplat.field.evidence.evidence import Evidence, MaskIds

EACH = 40  # Gaussians of a thing
STEPS = causes.Steps(0.9, 0.8, 0.7, 0.3, 0.3)  # threshold


@pytest.mark.parametrize("module", [causes, numbers, reading, stamps, tables])
def test_examples_in_docstrings(module: ModuleType) -> None:
    found = doctest.testmod(module)
    assert found.attempted
    assert not found.failed


def place(owners: list[int], shared: float) -> Any:
    """A mug on the left and a plate on the right, each of one thing per mask but for what is `shared`."""
    rng = np.random.default_rng(0)
    means = np.concatenate([rng.normal((x, 0, 4), 0.15, (EACH, 3)) for x in (-1.0, 1.0)]).astype(np.float32)
    gaussians = Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2 * EACH, 1)),
        scales=np.full((2 * EACH, 3), 0.1, np.float32),
        opacities=np.full(2 * EACH, 0.95, np.float32),
        sh=np.zeros((2 * EACH, 1, 3), np.float32),
    )
    labels = np.repeat(np.array([0, 1], np.int32), EACH)
    weights = np.eye(2, dtype=np.float32)[labels] * (1 - shared) + shared / 2
    seen = MaskIds(("view.png",), np.zeros(2, np.int32), np.arange(2, dtype=np.int32))
    evidence = Evidence(csr_array(weights.astype(np.float32)), seen, np.eye(2, dtype=np.float32))
    view = View("view.png", np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]]), np.eye(4), 96, 64)
    made: Any = SimpleNamespace(
        gaussians=gaussians, evidence=evidence, owners=np.array(owners, np.int32), labels=labels, views=[view]
    )
    culprits = causes.Culprits(made)
    left, right = (culprits.drawn(view, np.flatnonzero(labels == thing)) for thing in (0, 1))
    made.shown = lambda _: np.where(left, 0, np.where(right, 1, -1)).astype(np.int32)
    return culprits


def case() -> Any:
    meant = np.repeat([True, False], EACH)
    field = SimpleNamespace(gaussian_ids=np.arange(2 * EACH))
    return SimpleNamespace(field=field, present={"mug": meant}, mass=np.ones(2 * EACH))


def test_steps_of_a_scene_and_masks_without_a_fault() -> None:
    answer = answers.Answered("mug", 0.4, 0.3, 0.9, False, False, False)
    found = place([0, 1], 0.2).steps(case(), answer)
    assert found == causes.Steps(1.0, 1.0, 0.9, 0.4, 0.3)
    assert found.cause == "threshold"


def test_a_mask_of_two_things_is_the_cause() -> None:
    """Both masks show the mug and the plate alike: the best that can be selected is both."""
    answer = answers.Answered("mug", 0.4, 0.4, 0.45, False, False, False)
    found = place([0, 1], 1.0).steps(case(), answer)
    assert found.masks == pytest.approx(0.5)
    assert found.cause == "masks"


def test_gaussians_that_do_not_cover_the_outline_are_the_cause() -> None:
    culprits = place([0, 1], 0.0)
    culprits.place.shown = lambda view: np.zeros((view.height, view.width), np.int32)  # the mug is everywhere
    found = culprits.steps(case(), answers.Answered("mug", 0.8, 0.8, 0.9, False, False, False))
    assert found.scene < 0.2
    assert found.cause == "scene"


@given(st.lists(st.floats(0, 1, width=32), min_size=5, max_size=5))
def test_losses_add_up_to_what_is_missing(values: list[float]) -> None:
    steps = causes.Steps(*values)
    losses = dict(steps.losses)
    assert losses.pop("scene") == 1 - steps.scene
    assert sum(losses.values()) == pytest.approx(1 - steps.objects)


def test_the_best_threshold_is_the_best_of_all() -> None:
    rng = np.random.default_rng(1)
    values, meant, mass = rng.random(30), rng.random(30) < 0.4, rng.random(30)
    every = [(mass * ((values >= cut) & meant)).sum() / (mass * ((values >= cut) | meant)).sum() for cut in values]
    cut, best = answers.best_cut(values, meant, mass)
    assert (cut, best) == (values[int(np.argmax(every))], pytest.approx(max(every)))


def test_no_threshold_parts_equal_values() -> None:
    meant = np.array([True, True, False, False])
    assert answers.best_iou(np.ones(4), meant, np.ones(4)) == 0.5


def test_the_worst_are_of_many_places() -> None:
    def bad(where: str, text: str, iou: float, best: float) -> study_worst.Bad:
        answer = answers.Answered(text, iou, iou, best, False, False, False)
        return study_worst.Bad(where, "graph", 0, where, answer, STEPS)

    found = [bad("a", "mug", 0.0, 0.5), bad("a", "mug", 0.0, 0.9), bad("a", "cup", 0.1, 0.5), bad("a", "bed", 0.2, 0.5)]
    found += [bad("b", "mug", 0.3, 0.5), bad("b", "bed", 0.4, 0.5)]
    chosen = study_worst.worst(found, 3)
    assert [(one.place, one.answer.text, one.answer.best) for one in chosen] == [
        ("a", "mug", 0.9), ("a", "cup", 0.5), ("b", "mug", 0.5),
    ]  # fmt: skip
    assert study_worst.census(found).splitlines()[2] == "| rooms, graph | 0 | 0 | 0 | 6 | 0 |"
