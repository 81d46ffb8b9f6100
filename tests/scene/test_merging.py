"""Gaussians merged into fewer: moments in closed form, rows that stay, and pictures that stay alike."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import render
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.merging import areas_of, coarser, masses_of, merged, shapes_of
from refusing import refused
from scenes import gaussians_at, look_at_view, random_gaussians


def ball(*centers: tuple[float, float, float], opacity: float = 0.3, size: float = 0.1) -> Gaussians:
    scene = gaussians_at(np.array(centers), size, opacity=opacity)
    return replace(scene, sh=np.arange(3 * len(scene), dtype=np.float32).reshape(-1, 1, 3) / 10)


def test_two_at_one_place_become_one_of_the_summed_opacity():
    one = merged(ball((1, 2, 3), (1, 2, 3)), np.array([0, 0]))
    assert_allclose(one.means, [[1, 2, 3]])
    assert_allclose(one.scales, [[0.1, 0.1, 0.1]], rtol=1e-5)
    assert_allclose(one.opacities, [0.6], rtol=1e-5)
    assert_allclose(one.sh[0, 0], [0.15, 0.25, 0.35], rtol=1e-5)
    assert_array_equal(merged(ball((1, 2, 3), (1, 2, 3), opacity=0.8), np.array([0, 0])).opacities, [1])


def test_the_heavier_weighs_more():
    pair = replace(ball((0, 0, 0), (1, 0, 0)), opacities=np.float32([0.9, 0.1]))
    pair = replace(pair, extra={"object_id": np.int32([7, 8])})
    one = merged(pair, np.array([0, 0]))
    assert_allclose(one.means, [[0.1, 0, 0]], rtol=1e-5)
    assert_allclose(one.covariances()[0, 0], 0.01 + 0.9 * 0.1, rtol=1e-5)
    assert_array_equal(one.extra["object_id"], [7])


@given(st.integers(0, 500), st.integers(2, 30))
def test_moments_and_mass_stay_whatever_the_groups(seed, count):
    scene, rng = random_gaussians(count, seed), np.random.default_rng(seed)
    scene = replace(scene, opacities=rng.uniform(0.001, 0.01, count).astype(np.float32))
    whole = merged(scene, np.zeros(count, np.int64))
    halves = np.unique(rng.integers(0, 2, count), return_inverse=True)[1]
    twice = merged(merged(scene, halves), np.zeros(halves.max() + 1, np.int64))
    weights = masses_of(scene) / masses_of(scene).sum()
    assert_allclose(whole.means[0], weights @ scene.means, atol=1e-5)
    apart = scene.means - weights @ scene.means
    expected = scene.covariances() + apart[:, [0, 0, 0, 1, 1, 2]] * apart[:, [0, 1, 2, 1, 2, 2]]
    assert_allclose(whole.covariances()[0], weights @ expected, rtol=1e-4, atol=1e-5)
    assert_allclose(whole.opacities * areas_of(whole.scales), masses_of(scene).sum(), rtol=1e-4)
    assert_allclose(twice.covariances(), whole.covariances(), rtol=1e-3, atol=1e-4)


def test_shapes_are_those_of_their_covariances():
    scene = random_gaussians(200, 1)
    quats, scales = shapes_of(scene.covariances())
    assert_allclose(np.linalg.norm(quats, axis=1), 1, rtol=1e-6)
    assert_allclose(replace(scene, quats=quats, scales=scales).covariances(), scene.covariances(), atol=1e-6)


def test_pairs_that_are_near_and_alike_go_first():
    scene = ball((0, 0, 0), (0.01, 0, 0), (5, 0, 0), (9, 0, 0))
    level = coarser(scene, 3)
    assert_array_equal(level.group_of, [0, 0, 1, 2])
    assert_array_equal(level.gaussians.means[1:], scene.means[2:])  # rows that stay, stay to the bit
    assert_array_equal(level.gaussians.sh[1:], scene.sh[2:])


def test_objects_stay_apart():
    scene = ball((0, 0, 0), (0.01, 0, 0), (5, 0, 0), (6, 0, 0))
    level = coarser(scene, 1, np.array([0, 1, 0, 1]))
    assert_array_equal(level.group_of, [0, 1, 0, 1])
    assert len(level.gaussians) == 2


@pytest.mark.parametrize("count", [1, 7, 150, 300, 1000])
def test_the_count_is_reached_with_the_same_bits(count):
    scene = random_gaussians(300, 2)
    first, second = coarser(scene, count), coarser(scene, count)
    assert len(first.gaussians) == min(count, 300)
    assert_array_equal(np.unique(first.group_of), np.arange(len(first.gaussians)))
    assert_array_equal(first.gaussians.covariances(), second.gaussians.covariances())
    assert first.gaussians.fingerprint == second.gaussians.fingerprint


def test_merging_keeps_a_picture_better_than_leaving_out():
    scene = random_gaussians(600, 3)
    view = look_at_view([0.0, 0.0, -8.0], width=80, height=60)
    heavy = np.sort(np.argsort(-masses_of(scene))[:150])

    def error(fewer):
        return float(((render(fewer, view).rgb - render(scene, view).rgb) ** 2).mean())

    assert error(coarser(scene, 150).gaussians) < error(scene.subset(heavy))


def test_many_at_one_place_are_merged_still():
    scene = ball(*[(1.0, 1.0, 1.0)] * 40, opacity=0.001)
    assert len(coarser(scene, 1).gaussians) == 1


def test_what_cannot_be_merged_is_refused():
    with refused("count: expected 1 or more"):
        coarser(random_gaussians(5, 0), 0)
    with refused("within: expected 5 numbers"):
        coarser(random_gaussians(5, 0), 2, np.zeros(4, int))
