"""Thresholds chosen by the scores: closed forms, a slow twin, laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drsplat.query.thresholds import CUT_SHARE, PEAK_ROWS, automatic_threshold, peak_score, share_threshold
from refusing import refused

RULES = (automatic_threshold, lambda s: share_threshold(s, 0.3))
every_rule = pytest.mark.parametrize("rule", RULES, ids=["automatic", "share"])
few = settings(derandomize=True)
grids = st.lists(st.integers(-50, 50), min_size=2, max_size=60)  # sixteenths: no sum is rounded


def scores_of(numbers: list[int]) -> np.ndarray:
    return np.array(numbers, np.float64) / 16


def two_groups(
    low: float = 0.1, high: float = 0.3, many: int = 5000, few: int = 100, noise: float = 0.01
) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.concatenate([rng.normal(low, noise, many), rng.normal(high, noise, few)])


def test_the_peak_is_what_as_many_rows_reach_as_make_a_thing():
    assert peak_score(np.array([0.0, 1, 2, 3, 10]), peak=1) == 10
    assert peak_score(np.array([0.0, 1, 2, 3, 10]), peak=2) == 3
    assert peak_score(np.array([0.0, 1, 2, 3, 10])) == 0  # fewer rows than the peak: the lowest
    assert automatic_threshold(np.array([0.0, 1, 2, 3]), peak=1) == pytest.approx(
        2 + CUT_SHARE
    )  # in the middle the upper


def test_the_automatic_cut_lies_between_the_median_and_the_peak():
    scores = np.repeat([0.1, 0.3], [1000, PEAK_ROWS])
    assert automatic_threshold(scores) == pytest.approx(0.1 + CUT_SHARE * 0.2)
    short = np.repeat([0.1, 0.3], [1000, PEAK_ROWS - 1])  # a speck is no peak
    assert automatic_threshold(short) == 0.3


def test_equal_scores_select_nothing():
    same = np.full(100, 0.25)
    for rule in RULES[:3]:
        assert not (same > rule(same)).any()


@every_rule
def test_scores_that_are_none_or_not_finite_are_refused(rule):
    for scores in (np.empty(0), np.array([0.1, np.nan]), np.array([0.1, np.inf])):
        with refused("finite scores"):
            rule(scores)


def test_two_groups_are_told_apart():
    assert 0.15 < automatic_threshold(two_groups(few=1000)) < 0.25


def test_small_groups_are_found_by_the_peak():
    """Of 100 000 wide-spread Gaussians 60 are the thing."""
    scores = two_groups(many=100_000, few=60, noise=0.03, high=0.35)
    thing = np.arange(len(scores)) >= 100_000

    def iou(threshold):
        return float(((scores > threshold) & thing).sum() / ((scores > threshold) | thing).sum())

    assert iou(automatic_threshold(scores)) > 0.8


@few
@given(grids, st.integers(0, 20))
def test_a_share_is_never_exceeded_and_missed_only_by_equals(numbers, twentieths):
    scores, share = scores_of(numbers), twentieths / 20
    wanted, threshold = round(share * len(scores)), share_threshold(scores, share)
    selected = int((scores > threshold).sum())
    assert selected <= wanted
    assert selected == wanted or (scores == threshold).sum() > wanted - selected
    assert len(set(numbers)) < len(numbers) or selected == wanted


def test_a_share_lies_between_0_and_1():
    for share in (-0.1, 1.1, float("nan")):
        with refused("between 0 and 1"):
            share_threshold(np.ones(3), share)


@every_rule
@few
@given(numbers=grids, scale=st.sampled_from([0.25, 1.0, 8.0]), shift=st.integers(-20, 20))
def test_thresholds_follow_the_scores(rule, numbers, scale, shift):
    """What is selected stays the same when all scores are scaled and shifted."""
    scores = scores_of(numbers)
    moved = scale * scores + shift
    np.testing.assert_array_equal(scores > rule(scores), moved > rule(moved))


@every_rule
@few
@given(numbers=grids, seed=st.integers(0, 99))
def test_order_does_not_matter(rule, numbers, seed):
    scores = scores_of(numbers)
    shuffled = np.random.default_rng(seed).permutation(scores)
    assert rule(scores) == rule(shuffled)


@few
@given(grids, st.floats(0, 1), st.floats(0, 1))
def test_larger_shares_have_lower_thresholds(numbers, a, b):
    scores = scores_of(numbers)
    assert share_threshold(scores, max(a, b)) <= share_threshold(scores, min(a, b))


def test_float32_scores_keep_their_own_values():
    scores = np.linspace(0, 1, 1001, dtype=np.float32)
    assert (scores > share_threshold(scores, 0.25)).sum() == 250
    assert (scores > share_threshold(scores, 1.0)).all()
    assert not (scores > share_threshold(scores, 0.0)).any()
