"""Metrics: their own examples, cases worked out by hand, and laws."""

import doctest

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose

from drsplat.evaluation import scorers

few = settings(derandomize=True, max_examples=50)
TRUTH = np.array([1, 1, 1, 2, 2, 3, 0, 0])
PREDICTED = np.array([1, 1, 2, 2, 2, 1, 3, 0])


def test_examples():
    result = doctest.testmod(scorers, extraglobs={"np": np})
    assert result.attempted > 12
    assert result.failed == 0


def test_class_ious_by_hand():
    # class 1: 2 of {3 true, 3 predicted}; class 2: 2 of {2, 3}; class 3: found nowhere that counts
    assert_allclose(scorers.class_ious(PREDICTED, TRUTH, 3), [2 / 4, 2 / 3, 0])
    assert_allclose(scorers.class_accuracies(PREDICTED, TRUTH, 3), [2 / 3, 1, 0])


labels = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(1, 9)), min_size=1)


def weighted_iou(predicted: np.ndarray, truth: np.ndarray, weights: np.ndarray) -> float:
    """d . (p * g) / d . (p + g - p * g), Dr. Splat Eq. 3."""
    union = float(weights[predicted | truth].sum())
    return float(weights[predicted & truth].sum()) / union if union else 0.0


@few
@given(labels)
def test_class_iou_is_the_weighted_iou_of_its_masks(rows):
    predicted, truth, weights = (np.array(column) for column in zip(*rows, strict=True))
    counted = truth > 0
    got = scorers.class_ious(predicted, truth, 4, weights)
    for label in range(1, 5):
        alone = weighted_iou((predicted == label) & counted, truth == label, weights.astype(float))
        if (truth == label).any():
            assert got[label - 1] == pytest.approx(alone)
        else:
            assert np.isnan(got[label - 1])


@few
@given(st.lists(st.floats(-5, 5), min_size=3, max_size=9), st.floats(0.1, 9), st.floats(-9, 9))
def test_correlations_ignore_scale_and_offset(values, scale, offset):
    if np.ptp(values) < 0.1:
        return
    moved = [scale * value + offset for value in values]
    assert scorers.pearson(values, moved) == pytest.approx(1)
    assert scorers.spearman(values, [-v for v in values]) == pytest.approx(-1)


def test_spearman_is_scipys():
    from scipy.stats import spearmanr

    a, b = default_rng(0).integers(0, 6, (2, 20)).tolist()
    assert scorers.spearman(a, b) == pytest.approx(spearmanr(a, b).statistic)


def test_interval_holds_the_mean_and_narrows():
    values = default_rng(1).normal(0.5, 0.1, 40).tolist()
    low, high = scorers.mean_interval(values)
    assert low < np.mean(values) < high
    assert high - low < np.subtract(*scorers.mean_interval(values[:8])[::-1])
