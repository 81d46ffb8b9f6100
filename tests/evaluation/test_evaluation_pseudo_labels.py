"""Pseudo labels: closed forms, the all-pairs twin, and laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from drsplat.evaluation import pseudo_labels as module
from drsplat.evaluation.pseudo_labels import LabelledPoints, density_labels, pseudo_labels
from drsplat.scene.gaussians import Gaussians
from refusing import refused
from scenes import random_gaussians
from twins import evaluation as reference

few = settings(derandomize=True, max_examples=25)


def random_points(count: int, num_labels: int, seed: int = 0, extent: float = 2.0) -> LabelledPoints:
    """Labels in clumps, as things are."""
    rng = default_rng(seed)
    positions = rng.uniform(-extent, extent, (count, 3)).astype(np.float32)
    seeds = rng.uniform(-extent, extent, (3 * num_labels, 3))
    nearest = ((positions[:, None] - seeds) ** 2).sum(2).argmin(1)
    return LabelledPoints(positions, (nearest % num_labels).astype(np.int32))


def one_gaussian(mean=(0, 0, 0), scales=(1, 1, 1), quat=(1, 0, 0, 0)) -> Gaussians:
    columns = ([mean], [quat], [scales], [1.0], np.zeros((1, 1, 3)))
    return Gaussians(*(np.array(column, np.float32) for column in columns))


def cloud(rows: list[tuple[float, float, float, int]]) -> LabelledPoints:
    table = np.array(rows)
    return LabelledPoints(table[:, :3].astype(np.float32), table[:, 3].astype(np.int32))


def test_a_near_point_outvotes_two_far_ones():
    # exp(-0.5) = 0.61 against 2 exp(-2) = 0.27
    points = cloud([(1, 0, 0, 7), (0, 2, 0, 4), (0, -2, 0, 4)])
    assert density_labels(one_gaussian(), points)[0] == 7
    # the sums of squared distances, which the paper's Eq. 2 prints, are 1 and 8
    assert reference.printed_labels(one_gaussian(), points.positions.astype(np.float64), points.labels)[0] == 4


@pytest.mark.parametrize(("x", "expected"), [(2.99, 5), (3.01, -1)])
def test_what_is_beyond_the_cut_off_has_no_vote(x, expected):
    assert density_labels(one_gaussian(), cloud([(x, 0, 0, 5)]))[0] == expected


def decided(votes: np.ndarray, margin: float = 1e-4) -> np.ndarray:
    """Rows whose winner leads by more than rounding."""
    first, second = -np.sort(-votes, axis=1)[:, :2].T
    return first > second * (1 + margin) + 1e-9


@few
@given(st.integers(0, 1000), st.sampled_from([0.08, 0.3, 1.5]), st.integers(2, 6))
def test_density_labels_are_the_twins(seed, size, num_labels):
    gaussians = random_gaussians(200, seed, size=size)
    points = random_points(1500, num_labels, seed)
    got = density_labels(gaussians, points)
    votes = reference.density_votes(
        gaussians, points.positions.astype(np.float64), points.labels, module.CUT_OFF_SIGMAS
    )
    clear = decided(votes)
    assert clear.any()
    assert_array_equal(got[clear], votes.argmax(1)[clear])
    border = votes.sum(1) < 0.02  # exp(-4.5) = 0.011: one point on the very edge
    assert_array_equal(got[~border] == -1, ~votes.any(1)[~border])


def test_crowded_gaussians_are_judged_by_a_sample():
    """Wide Gaussians have all 40,000 points in their box; a clear majority stays one."""
    gaussians = random_gaussians(60, 3, size=2.0)
    points = random_points(40_000, 3, 1)
    assert len(points.labels) > module.MAX_CANDIDATES
    votes = reference.density_votes(gaussians, points.positions.astype(np.float64), points.labels, 3.0)
    clear = decided(votes, margin=0.3)
    assert clear.sum() > 10
    assert_array_equal(density_labels(gaussians, points)[clear], votes.argmax(1)[clear])


def test_threads_and_blocks_change_nothing(monkeypatch):
    gaussians, points = random_gaussians(3000, 5), random_points(20_000, 9)
    expected = density_labels(gaussians, points, threads=1)
    assert len(np.unique(expected)) > 5
    monkeypatch.setattr(module, "MAX_PAIRS", 5000)
    assert_array_equal(density_labels(gaussians, points, threads=3), expected)


@pytest.mark.parametrize(("x", "expected"), [(1.0, 4), (3.9, 4), (5.1, -1)])
def test_between_the_points_the_nearest_decides(x, expected):
    """Points a length of 1 apart, the last at (1, 0, 0): three spacings reach to 4."""
    points = cloud([(-1, 0, 0, 9), (0, 0, 0, 9), (1, 0, 0, 4)])
    small = one_gaussian(mean=(x + 0.5 if x == 1.0 else x, 0, 0), scales=(0.01, 0.01, 0.01))
    assert density_labels(small, points)[0] == -1
    assert pseudo_labels(small, points)[0] == expected


def test_the_vote_comes_before_the_nearest():
    rng = default_rng(0)
    crowd = [(1 + 0.1 * x, 0.1 * y, 0.1 * z, 2) for x, y, z in rng.normal(size=(20, 3)).tolist()]
    points = cloud([(0.1, 0, 0, 1), *crowd])
    gaussians, scattered = one_gaussian(), random_points(800, 4)
    assert pseudo_labels(gaussians, points)[0] == density_labels(gaussians, points)[0] == 2
    many = random_gaussians(300, 1)
    voted = density_labels(many, scattered)
    assert_array_equal(pseudo_labels(many, scattered)[voted >= 0], voted[voted >= 0])


@pytest.mark.parametrize(("rows", "message"), [([(0, 0, np.nan, 1)], "finite"), ([(0, 0, 0, -1)], "0 or more")])
def test_bad_points_are_refused(rows, message):
    with refused(message):
        density_labels(one_gaussian(), cloud(rows))


def test_no_points_are_refused():
    empty = LabelledPoints(np.zeros((0, 3), np.float32), np.zeros(0, np.int32))
    with refused("one label per point"):
        density_labels(one_gaussian(), empty)
