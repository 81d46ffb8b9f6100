"""Places that a thing surrounds: the same as by comparing every place with every point, for far fewer comparisons."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from drsplat.authoring.editing import resolving, surrounding
from drsplat.authoring.editing.resolving import DIRECTIONS, MIN_SURROUNDED_SHARE, enclosed
from drsplat.authoring.editing.surrounding import surrounded
from scenes import random_gaussians

SPHERE = resolving._sphere(DIRECTIONS)
MIN_BINS = math.ceil(MIN_SURROUNDED_SHARE * DIRECTIONS)


def of_all_pairs(places: np.ndarray, points: np.ndarray, directions: np.ndarray, min_bins: int) -> np.ndarray:
    """The slow twin."""
    nearest = np.einsum("pti,di->ptd", points[None] - places[:, None], directions).argmax(axis=2)
    return np.array([len(np.unique(bins)) >= min_bins for bins in nearest], bool)


def shell(random: np.random.Generator, count: int, closed: float = 1.0) -> np.ndarray:
    """Points on a unit sphere, below a height that leaves out a share of it."""
    points = random.normal(size=(8 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points[points[:, 2] <= 2 * closed - 1][:count]


@pytest.mark.parametrize("closed", [1.0, 0.9, 0.7, 0.1])
@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e4])
def test_it_is_that_of_all_pairs(closed, scale):
    random = default_rng(int(100 * closed))
    points, places = shell(random, 700, closed), random.uniform(-1.1, 1.1, (900, 3))
    places[:50] = points[:50]  # at the points themselves, which lie in no direction
    points, places = (scale * some + 7 * scale for some in (points, places))
    inside = surrounded(places, points, SPHERE, MIN_BINS)
    assert_array_equal(inside, of_all_pairs(places, points, SPHERE, MIN_BINS))
    assert not inside.all()
    assert inside.any() == (closed > 0.5)


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.integers(0, 90), st.integers(1, 3), st.integers(0, 12))
def test_it_is_that_of_all_pairs_on_a_coarse_grid(seed, places, points, cells, bins):
    """Many points as near to one direction as to another, and places at points."""
    random = default_rng(seed)
    directions = np.concatenate([np.eye(3), -np.eye(3), SPHERE[:6]])
    some, thing = (random.integers(-cells, cells + 1, (n, 3)).astype(np.float64) for n in (places, points))
    expected = of_all_pairs(some, thing, directions, bins)
    assert_array_equal(surrounded(some, thing, directions, bins), expected)


def test_few_pairs_are_compared(monkeypatch):
    """An object of a hundred thousand Gaussians took minutes."""
    random, compared = default_rng(0), 0
    points, places = shell(random, 1500), random.uniform(-1.5, 1.5, (20_000, 3))

    def counting(real, per_place):
        def compute(places, points, *more):
            nonlocal compared
            compared += len(points) * (len(places) if per_place else 1)
            return real(places, points, *more)

        return compute

    monkeypatch.setattr(surrounding, "_bins", counting(surrounding._bins, True))
    monkeypatch.setattr(surrounding, "_in_box", counting(surrounding._in_box, False))
    inside = surrounded(places, points, SPHERE, MIN_BINS)
    lengths = np.linalg.norm(places, axis=1)
    assert inside[lengths < 0.8].all()
    assert not inside[lengths > 1.0].any()
    assert 0 < compared < len(points) * len(places) / 8


def test_a_thing_encloses_what_is_in_it_and_not_itself():
    random = default_rng(1)
    gaussians = random_gaussians(900)
    gaussians.means[:700] = shell(random, 700)
    gaussians.means[700:] = random.uniform(-0.4, 0.4, (200, 3))
    gaussians.means[800:] += 5
    gaussians.opacities[:] = 0.9
    inside = np.arange(900) < 700
    assert_array_equal(np.flatnonzero(enclosed(gaussians, inside)), np.arange(700, 800))
    assert not enclosed(gaussians, np.zeros(900, bool)).any()
