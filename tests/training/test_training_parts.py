"""The parts of training that need no rendering: settings, schedules, first Gaussians, rows and moments,
density control by hand-computed cases, relocation by its closed form, photos and their order."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from scipy import integrate

from drsplat import TrainingSettings, View
from drsplat.base import progress
from drsplat.formats.activation import sigmoid
from drsplat.formats.captures import SparsePoints
from drsplat.fronts.commands.train import EVERYDAY_ITERATIONS, ORIGINAL_ITERATIONS
from drsplat.kernels.training import Gradients, Rates, SceneParameters
from drsplat.scene.gaussians import SH_C0, rotation_matrices
from drsplat.training.density import (
    AdaptiveDensity,
    MonteCarlo,
    drawn,
    grow,
    relocate,
    reset_opacity,
    shared_place,
    split,
    unit,
)
from drsplat.training.devices import budget_of, everyday
from drsplat.training.metrics import psnr, ssim
from drsplat.training.optimizer import Optimizer
from drsplat.training.settings import active_sh_degree, divisor, means_rate, other_rates_share, refines, resets_opacity
from drsplat.training.start import first_gaussians, scene_extent, split_views
from drsplat.training.start_points import start_points
from drsplat.training.training_photos import Photo, TrainingPhotos, ViewOrder
from refusing import refused
from scenes import look_at_view

DEFAULT = TrainingSettings()
RATES = Rates(1e-2, 1e-2, 1e-2, 1e-2, 1e-1, 1e-3)


def parameters(count: int, seed: int = 0, sh: int = 4) -> SceneParameters:
    rng = default_rng(seed)
    shapes = ((count, 3), (count, 3), (count, 4), (count,), (count, sh, 3))
    return SceneParameters(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))


def gradients(of: SceneParameters, seed: int = 1) -> Gradients:
    rng = default_rng(seed)
    slopes = [rng.normal(size=array.shape).astype(np.float32) for array in of]
    return Gradients(*slopes, *np.zeros((2, len(of.means)), np.float32))


def marked_optimizer(count: int, scale: Any = 0.005) -> Optimizer:
    """Row i has means i and moments 10 + i, 20 + i everywhere, so that rows can be followed; all are well visible."""
    optimizer = Optimizer(parameters(count))
    optimizer.parameters.log_scales[:], optimizer.parameters.logits[:] = np.log(scale), 2
    for arrays, base in ((optimizer.first, 10), (optimizer.second, 20)):
        for array in arrays:
            array[:] = (base + np.arange(count)).reshape(-1, *[1] * (array.ndim - 1))
    optimizer.parameters.means[:] = np.arange(count)[:, None]
    return optimizer


def observed(
    s: TrainingSettings, count: int, pull: list[float], *, seen: int = 1, extent: float = 1.0
) -> AdaptiveDensity:
    density = AdaptiveDensity(s, extent, count)
    empty = gradients(parameters(count))
    pulls = np.array(pull, np.float32)
    for _ in range(seen):
        density.observe(empty._replace(screen=pulls, radii=np.full(count, 5, np.float32)), 1)
    return density


# --- settings and schedules ---


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"iterations": 0}, "iterations"),
        ({"seed": -1}, "seed"),
        ({"strategy": "magic"}, "strategy"),
        ({"background": "pink"}, "background"),
        ({"sh_degree": 4}, "sh_degree"),
        ({"strategy": "mcmc"}, "max_gaussians"),
        ({"max_gaussians": 0}, "max_gaussians"),
        ({"test_every": 1}, "test_every"),
        ({"means_rate": float("nan")}, "means_rate"),
        ({"scales_rate": -1.0}, "scales_rate"),
        ({"dssim_weight": 1.5}, "dssim_weight"),
        ({"start_opacity": 1.0}, "start_opacity"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, said):
    with refused(said):
        TrainingSettings(**wrong)


def test_the_position_rate_decays_exponentially():
    assert means_rate(DEFAULT, 0) == pytest.approx(1.6e-4)
    assert means_rate(DEFAULT, 15_000) == pytest.approx(1.6e-5)
    assert means_rate(DEFAULT, 30_000) == pytest.approx(1.6e-6)
    assert means_rate(DEFAULT, 90_000) == pytest.approx(1.6e-6)
    assert means_rate(replace(DEFAULT, means_rate=0.0), 500) == 0


def test_other_rates_fall_to_a_tenth_at_the_end_of_an_everyday_run():
    s = everyday([look_at_view((1, 0, 0))], 1000)
    assert [other_rates_share(s, i) for i in (1, 500, 800)] == [1, 1, 1]
    assert other_rates_share(s, 900) == pytest.approx(0.1**0.5)
    assert other_rates_share(s, 1000) == pytest.approx(0.1)
    assert {other_rates_share(DEFAULT, i) for i in (1, 15_000, 30_000)} == {1}
    assert other_rates_share(replace(DEFAULT, iterations=1, rates_fall_from=1), 1) == 1


def test_a_shorter_run_is_the_beginning_of_the_longer_one():
    short = replace(DEFAULT, iterations=7000)
    for iteration in range(1, 6501):
        for schedule in (means_rate, active_sh_degree, refines, resets_opacity):
            assert schedule(short, iteration) == schedule(DEFAULT, iteration)


def test_a_reset_comes_only_where_there_is_time_to_recover():
    for iterations, last in ((3000, []), (3499, []), (3500, [3000]), (6400, [3000])):
        s = replace(DEFAULT, iterations=iterations)
        assert [i for i in range(1, iterations + 1) if resets_opacity(s, i)] == last


def test_photos_are_a_quarter_then_a_half_then_two_thirds_then_as_they_are():
    s = replace(DEFAULT, full_size_from=50)
    sides = [divisor(s, i) for i in range(1, 70)]
    assert sides == [4] * 3 + [2] * 28 + [1.5] * 18 + [1] * 20
    assert {divisor(DEFAULT, i) for i in range(1, 100)} == {1}


@pytest.mark.parametrize("strategy", ["default", "mcmc"])
@pytest.mark.parametrize("iterations", [1, 7, 400, 3000, 50_000])
def test_an_everyday_schedule_comes_to_its_end_with_its_iterations(iterations, strategy):
    s = everyday([look_at_view((1, 0, 0))], iterations, strategy=strategy, background="white")
    assert means_rate(s, iterations) == pytest.approx(s.means_rate_end)
    assert active_sh_degree(s, iterations) == (3 if iterations >= 7 else 1)
    assert s.full_size_from <= 0.7 * iterations + 1
    assert s.refine_until <= iterations
    assert not any(resets_opacity(s, i) for i in range(1, iterations + 1))
    assert s.penalty_of_opacity == (0.01 if strategy == "mcmc" else 0.03)


def test_the_everyday_budget_follows_the_pixels():
    view = look_at_view((1, 0, 0), width=190, height=100)
    assert budget_of([view]) == budget_of([view] * 100) == 10_000
    assert budget_of([view] * 1000) == 100_000
    assert budget_of([view.resized(380, 200)] * 7) == 40_000
    assert everyday([view], max_gaussians=77).max_gaussians == 77
    assert everyday([view], max_gaussians=None).max_gaussians == 10_000


def test_the_command_knows_the_everyday_iterations():
    assert everyday([]).iterations == EVERYDAY_ITERATIONS
    assert DEFAULT.iterations == ORIGINAL_ITERATIONS


def test_a_coarser_photo_has_means_of_pixels_and_uses_none_that_has_a_part_of_an_unused_one():
    pixels = np.zeros((4, 6, 3), np.uint8)
    pixels[:2, :2, 0] = [[10, 20], [30, 40]]
    outside = np.zeros((4, 6), bool)
    outside[0, 5] = True
    smaller = Photo(pixels, outside).smaller(3, 2)
    assert smaller.pixels[..., 0].tolist() == [[25, 0, 0], [0, 0, 0]]
    assert np.flatnonzero(smaller.unused).tolist() == [2]
    left_out = np.zeros((4, 6), bool)
    left_out[3, 0] = True
    assert np.flatnonzero(Photo(pixels, outside, left_out).smaller(3, 2).unused).tolist() == [2, 3]
    assert Photo(pixels).smaller(3, 2).unused is None


def test_two_thirds_of_a_photo_mix_parts_of_pixels_and_use_none_with_a_part_of_an_unused_one():
    ramp = np.broadcast_to(np.arange(0, 240, 20, np.uint8)[None, :, None], (12, 12, 3))
    outside = np.zeros((12, 12), bool)
    outside[6:, 5] = True
    smaller = Photo(np.ascontiguousarray(ramp), outside).smaller(8, 8)
    assert smaller.pixels[4, 1:-1, 0].tolist() == pytest.approx([20 * (1.5 * k + 0.25) for k in range(1, 7)], abs=1)
    covered = np.zeros((8, 8), bool)
    covered[4:, 3] = True  # pixels 4.5 to 6
    assert (smaller.unused | ~covered).all()


def test_the_fingerprint_is_of_what_changes_the_result():
    same = replace(DEFAULT, evaluate_every=5, photo_memory_bytes=0)
    assert same.fingerprint == DEFAULT.fingerprint != replace(DEFAULT, seed=1).fingerprint
    assert replace(DEFAULT, antialiased=True).fingerprint != DEFAULT.fingerprint


def test_limited_colors_are_from_black_to_white_and_nothing_else_changes():
    optimizer = Optimizer(parameters(50))
    optimizer.parameters.sh[:] *= 3
    before = [array.copy() for array in optimizer.parameters]
    optimizer.limit_colors()
    colors = 0.5 + SH_C0 * before[4][:, 0].astype(np.float64)
    assert not ((colors > 0) & (colors < 1)).all()
    after = 0.5 + SH_C0 * optimizer.parameters.sh[:, 0].astype(np.float64)
    assert_allclose(after, np.clip(colors, 0, 1), atol=1e-7)
    assert_array_equal(optimizer.parameters.sh[:, 1:], before[4][:, 1:])
    for array, unchanged in zip(optimizer.parameters[:4], before[:4], strict=True):
        assert_array_equal(array, unchanged)


def test_harmonics_come_every_thousand_iterations():
    degrees = [active_sh_degree(DEFAULT, i) for i in (1, 999, 1000, 1999, 2000, 3000, 30_000)]
    assert degrees == [0, 0, 1, 1, 2, 3, 3]
    assert active_sh_degree(replace(DEFAULT, sh_degree=1), 9000) == 1


def test_refinement_is_between_500_and_15000_every_100():
    due = [i for i in range(1, 30_001) if refines(DEFAULT, i)]
    assert (due[0], due[-1], len(due)) == (600, 14_900, 144)
    monte_carlo = replace(DEFAULT, strategy="mcmc", max_gaussians=9)
    assert [i for i in range(1, 30_001) if refines(monte_carlo, i)][-1] == 24_900


def test_opacity_is_reset_every_3000():
    assert [i for i in range(1, 30_001) if resets_opacity(DEFAULT, i)] == [3000, 6000, 9000, 12_000]
    white = replace(DEFAULT, background="white")
    assert [i for i in range(1, 5000) if resets_opacity(white, i)] == [500, 3000]


# --- where it starts ---


def circle(count: int = 8, radius: float = 3.0, path: Path | None = Path("photo.png")) -> list[View]:
    turns = 2 * np.pi * np.arange(count) / count
    views = [look_at_view((radius * np.cos(t), radius * np.sin(t), 0.0)) for t in turns]
    return [replace(v, name=f"{i:02}.png", image_path=path) for i, v in enumerate(views)]


def points(positions: np.ndarray) -> SparsePoints:
    return SparsePoints(positions, np.full(positions.shape, 200, np.uint8))


def test_every_eighth_view_by_name_is_held_out():
    split = split_views(circle(17)[::-1], 8)
    assert [view.name for view in split.test] == ["00.png", "08.png", "16.png"]
    assert len(split.train) == 14
    assert split_views(circle(5), 0).test == []


def test_extent_is_a_tenth_more_than_the_farthest_camera():
    assert scene_extent(circle(8, 3.0)) == pytest.approx(3.3, rel=1e-5)


@pytest.mark.parametrize(
    ("views", "test_every", "said"),
    [
        ([], 8, "got 0"),
        (circle(1), 8, "got 1"),
        (circle(2), 8, "test_every=0"),
        (circle(8, path=None), 8, "8 of 8 views have no photo.*images=FOLDER"),
        (circle(8, radius=1e-9), 8, "in one place"),
        ([*circle(4), *circle(4)], 8, "one name"),
    ],
)
def test_views_that_cannot_be_trained_on_are_refused(views, test_every, said):
    with refused(said):
        split_views(views, test_every)


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        (np.full((9, 3), np.nan), "9 of 9 points are not finite, the first at index 0"),
        (np.diag([1.0, 1, np.inf]), "the first at index 2"),
        (np.eye(3), "3 points are too few"),
        (np.eye(4), "expected positions"),
    ],
)
def test_points_that_cannot_be_started_from_are_refused(positions, said):
    with refused(said):
        start_points(points(positions), circle(), DEFAULT, default_rng(0))


def test_a_budget_thins_the_points():
    many = points(default_rng(0).normal(size=(50, 3)))
    start = start_points(many, circle(), replace(DEFAULT, max_gaussians=20), default_rng(0))
    assert start.plain() == {"given": 20, "triangulated": 0, "random": 0}
    kept = start.points
    rows = {tuple(row) for row in many.positions}
    assert len(kept.positions) == 20
    assert all(tuple(row) in rows for row in kept.positions)


def test_first_gaussians_are_as_large_as_their_neighbours_are_far():
    corners = points(np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]))
    first = first_gaussians(corners, DEFAULT)
    assert np.exp(first.log_scales[0]) == pytest.approx([math.sqrt((1 + 4 + 9) / 3)] * 3)
    assert sigmoid(first.logits) == pytest.approx([0.1] * 4)
    assert first.sh.shape == (4, 16, 3)
    assert 0.5 + 0.28209479177387814 * first.sh[:, 0] == pytest.approx(np.full((4, 3), 200 / 255))
    assert not first.sh[:, 1:].any()
    small = first_gaussians(corners, replace(DEFAULT, strategy="mcmc", max_gaussians=9))
    assert small.log_scales - first.log_scales == pytest.approx(np.full((4, 3), math.log(0.1)))
    assert sigmoid(small.logits) == pytest.approx([0.5] * 4)


def test_points_in_one_place_have_a_size():
    first = first_gaussians(points(np.zeros((5, 3))), DEFAULT)
    assert np.exp(first.log_scales) == pytest.approx(np.full((5, 3), math.sqrt(1e-7)))


# --- rows and moments ---


def test_the_first_step_of_adam_is_the_rate_against_the_slope():
    optimizer = Optimizer(parameters(6))
    before, slope = optimizer.rows(np.arange(6)), gradients(optimizer.parameters)
    optimizer.step(slope, RATES, 1)
    for name in ("means", "log_scales", "quats", "logits"):
        moved = getattr(optimizer.parameters, name) - getattr(before, name)
        assert moved == pytest.approx(-1e-2 * np.sign(getattr(slope, name)), abs=1e-5)
    moved = optimizer.parameters.sh - before.sh
    assert moved[:, 0] == pytest.approx(-1e-1 * np.sign(slope.sh[:, 0]), abs=1e-5)
    assert moved[:, 1:] == pytest.approx(-1e-3 * np.sign(slope.sh[:, 1:]), abs=1e-5)
    assert optimizer.first.sh == pytest.approx(0.1 * slope.sh, rel=1e-4)
    assert optimizer.second.sh == pytest.approx(0.001 * slope.sh**2, rel=1e-4)


def test_moments_follow_their_rows():
    optimizer = marked_optimizer(5)
    optimizer.keep(np.array([4, 1, 3]))
    optimizer.append(parameters(2, seed=9))
    assert optimizer.parameters.means[:3, 0].tolist() == [4, 1, 3]
    for arrays, base in ((optimizer.first, 10), (optimizer.second, 20)):
        for array in arrays:
            rows = array.reshape(5, -1)[:, 0].tolist()
            assert rows == [base + 4, base + 1, base + 3, 0, 0]
            assert array.flags.c_contiguous


def test_scales_beyond_float32_are_kept_in_range():
    made = parameters(3)
    made.log_scales[:] = [[-500, 0, 500]] * 3
    scales = Optimizer(made).gaussians().scales
    assert np.isfinite(scales).all()
    assert (scales > 0).all()


# --- adaptive density control ---


def test_small_ones_are_cloned_large_ones_split_faint_ones_pruned():
    """Extent 1: 'large' is above 0.01. Rows: small pulled, large pulled, small still, faint still."""
    optimizer = marked_optimizer(4, [[0.005], [0.05], [0.005], [0.005]])
    optimizer.parameters.logits[3] = -6  # sigmoid(-6) = 0.0025
    density = observed(DEFAULT, 4, [3e-4, 3e-4, 1e-4, 1e-4])
    density.after_step(optimizer, 600, default_rng(0), 0.0)
    means, scales = optimizer.parameters.means, np.exp(optimizer.parameters.log_scales)
    assert means[:3, 0].tolist() == [0, 2, 0]  # the small, the still, the clone of the small
    assert scales[:3] == pytest.approx(np.full((3, 3), 0.005))
    assert scales[3:] == pytest.approx(np.full((2, 3), 0.05 / 1.6))  # the children of the large
    assert np.abs(means[3:] - 1).max() < 6 * 0.05
    assert (means[3] != means[4]).all()
    assert optimizer.first.means[:, 0].tolist() == [10, 12, 0, 0, 0]
    assert len(density.pull) == 5
    assert not density.pull.any()


def test_the_threshold_is_on_the_mean_over_the_views_that_saw_it():
    optimizer = marked_optimizer(2)
    density = observed(DEFAULT, 2, [3e-4, 1.9e-4], seen=4)
    unseen = gradients(optimizer.parameters)
    density.observe(unseen, 5)  # radii 0: does not count
    density.after_step(optimizer, 600, default_rng(0), 0.0)
    assert optimizer.parameters.means[:, 0].tolist() == [0, 1, 0]


@pytest.mark.parametrize(
    ("iteration", "limit", "left"), [(600, None, 2), (3100, None, 1), (3100, 20.0, 1), (3100, 4.0, 0)]
)
def test_huge_ones_are_pruned_after_the_first_reset_large_ones_on_screen_where_asked(iteration, limit, left):
    optimizer = marked_optimizer(3, [[0.05], [0.2], [0.2]])  # extent 1: at most 0.1
    optimizer.parameters.log_scales[2] = math.log(0.005)
    density = observed(replace(DEFAULT, max_screen_px=limit), 3, [0, 0, 0])
    density.radii[2] = 2
    density.after_step(optimizer, iteration, default_rng(0), 0.0)
    assert len(optimizer) == left + 1


def test_somebody_is_left():
    optimizer = marked_optimizer(3)
    optimizer.parameters.logits[:] = [-9, -8, -9]
    observed(DEFAULT, 3, [0, 0, 0]).after_step(optimizer, 600, default_rng(0), 0.0)
    assert optimizer.parameters.means[:, 0].tolist() == [1]


def test_a_budget_takes_those_that_are_pulled_most():
    optimizer = marked_optimizer(4)
    density = observed(replace(DEFAULT, max_gaussians=6), 4, [3e-4, 9e-4, 5e-4, 8e-4])
    density.after_step(optimizer, 600, default_rng(0), 0.0)
    assert optimizer.parameters.means[:, 0].tolist() == [0, 1, 2, 3, 1, 3]


def test_a_reset_leaves_no_opacity_above_a_hundredth_and_no_moments():
    optimizer = marked_optimizer(3)
    optimizer.parameters.logits[:] = [5, 0, -7]
    reset_opacity(optimizer, 0.01)
    assert sigmoid(optimizer.parameters.logits) == pytest.approx([0.01, 0.01, 0.000911], rel=1e-3)
    assert not optimizer.first.logits.any()
    assert not optimizer.second.logits.any()
    assert optimizer.first.means[:, 0].tolist() == [10, 11, 12]


def test_children_are_drawn_from_their_parent():
    """The covariance of many children is the parent's."""
    one = parameters(1, seed=3)
    many = SceneParameters(*(np.repeat(array, 20_000, axis=0) for array in one))
    children = split(many, default_rng(0))
    offsets = (children.means - one.means).astype(np.float64)
    axes = rotation_matrices(unit(one.quats))[0] * np.exp(one.log_scales[0])
    expected = axes @ axes.T
    assert np.abs(np.cov(offsets.T) - expected).max() < 0.03 * np.abs(expected).max()
    assert np.exp(children.log_scales[0]) == pytest.approx(np.exp(one.log_scales[0]) / 1.6)


# --- Markov chain Monte Carlo ---


@settings(derandomize=True)
@given(opacity=st.floats(0.01, 0.99), sharing=st.integers(2, 20))
def test_sharing_a_place_keeps_the_picture(opacity, sharing):
    """N in front of each other block as much at the centre, and as much along a line, as the one did."""
    each, shrink = shared_place(np.array([opacity]), np.array([sharing]))
    assert 1 - (1 - each[0]) ** sharing == pytest.approx(opacity, rel=1e-9)

    def blocked(x):
        return 1 - (1 - each[0] * math.exp(-0.5 * (x / shrink[0]) ** 2)) ** sharing

    along = integrate.quad(blocked, -30, 30, points=(-1, 0, 1), limit=200)[0]
    assert along == pytest.approx(opacity * math.sqrt(2 * math.pi), rel=1e-5)


def test_the_dead_move_onto_the_living():
    optimizer = marked_optimizer(3)
    optimizer.parameters.logits[:] = [-8, 1, -9]
    scales = optimizer.parameters.log_scales[1].copy()
    relocate(optimizer, default_rng(0), 0.005)
    assert optimizer.parameters.means[:, 0].tolist() == [1, 1, 1]
    opacities = sigmoid(optimizer.parameters.logits)
    assert opacities == pytest.approx([opacities[0]] * 3)
    assert 1 - (1 - opacities[0]) ** 3 == pytest.approx(1 / (1 + math.exp(-1)), rel=1e-5)
    assert (optimizer.parameters.log_scales < scales).all()
    assert not any(array.any() for array in (*optimizer.first, *optimizer.second))


def test_growth_is_a_twentieth_up_to_the_budget():
    optimizer = Optimizer(parameters(100))
    rng = default_rng(0)
    grow(optimizer, rng, 0.05, 1000, 0.005)
    assert len(optimizer) == 105
    grow(optimizer, rng, 0.05, 107, 0.005)
    assert len(optimizer) == 107
    grow(optimizer, rng, 0.05, 107, 0.005)
    assert len(optimizer) == 107


def test_drawing_is_in_proportion():
    weights = np.float32([1, 0, 3])
    counts = np.bincount(drawn(weights, 40_000, default_rng(0)), minlength=3)
    assert counts[1] == 0
    assert counts[2] / counts[0] == pytest.approx(3, rel=0.05)


def monte_carlo() -> MonteCarlo:
    return MonteCarlo(TrainingSettings(strategy="mcmc", max_gaussians=1000), 1.0, 0)


def test_noise_moves_the_faint_along_their_axes_and_leaves_the_visible():
    made = parameters(2000)
    made.quats[:] = [2, 0, 0, 2]  # a quarter about z, not normalised
    made.log_scales[:] = np.log([0.2, 0.02, 0.02])
    made.logits[:1000], made.logits[1000:] = 3, -9
    optimizer, before = Optimizer(made), made.means.copy()
    monte_carlo().after_step(optimizer, 601, default_rng(0), 1e-6)
    moved = optimizer.parameters.means - before
    assert np.abs(moved[:1000]).max() == 0
    strength = 1 / (1 + math.exp(-100 * (0.005 - 1 / (1 + math.exp(9)))))
    expected = strength * 5e5 * 1e-6 * np.array([0.02, 0.2, 0.02]) ** 2
    assert moved[1000:].std(axis=0) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("density", "of_opacity", "of_scale"),
    [
        (AdaptiveDensity(replace(DEFAULT, opacity_penalty=0.3), 1.0, 5), 0.3, 0.0),
        (AdaptiveDensity(DEFAULT, 1.0, 5), 0.0, 0.0),
        (monte_carlo(), 0.01, 0.01),
    ],
)
def test_penalties_are_the_slopes_of_mean_opacity_and_mean_scale(density, of_opacity, of_scale):
    optimizer = Optimizer(parameters(5))
    slopes = Gradients(*(np.zeros_like(array) for array in optimizer.parameters), *np.zeros((2, 5), np.float32))
    density.penalize(optimizer, slopes)
    opacities = 1 / (1 + np.exp(-optimizer.parameters.logits.astype(np.float64)))
    assert_allclose(slopes.logits, of_opacity / 5 * opacities * (1 - opacities), rtol=1e-5)
    assert_allclose(slopes.log_scales, of_scale / 15 * np.exp(optimizer.parameters.log_scales), rtol=1e-5)
    assert not any(getattr(slopes, name).any() for name in ("means", "quats", "sh"))


# --- photos and measures ---


@pytest.mark.slow
def test_photos_beyond_the_budget_are_read_again(tmp_path, monkeypatch):
    path = tmp_path / "photo.png"
    Image.fromarray(np.full((112, 160, 3), 51, np.uint8)).save(path)
    views, reads = circle(4, path=path), []
    from drsplat.training import training_photos

    def counting(view):
        reads.append(view.name)
        return np.asarray(Image.open(path))

    monkeypatch.setattr(training_photos, "load_image", counting)
    photos = TrainingPhotos(views, 2 * 112 * 160 * 3)
    for index in (0, 1, 2, 3, 0, 1, 2, 3):
        assert photos[index].colors() == pytest.approx(np.full((112, 160, 3), 0.2, np.float32))
    assert reads == ["00.png", "01.png", "02.png", "03.png", "02.png", "03.png"]


def test_the_last_coarse_photo_is_kept_while_there_is_room(tmp_path):
    path = tmp_path / "photo.png"
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (112, 160, 3), np.uint8)).save(path)
    views = circle(2, path=path)
    full = 112 * 160 * 3
    photos, few = TrainingPhotos(views, 2 * full + full // 2), TrainingPhotos(views, full)
    for size in ((40, 28), (80, 56), (160, 112), (80, 56)):
        coarse = photos.on_raster(0, *size)
        assert photos.on_raster(0, *size) is coarse
        assert np.array_equal(coarse.pixels, photos[0].smaller(*size).pixels)
        assert np.array_equal(few.on_raster(0, *size).pixels, coarse.pixels)
    assert photos.on_raster(0, 160, 112) is photos[0]
    assert photos._room == full + full // 2 - full // 4
    assert few._room == 0
    assert not few._coarse
    assert photos.with_masks_of(views)._room == full + full // 2


def test_pixels_that_no_photo_covers_are_marked(tmp_path):
    path = tmp_path / "photo.png"
    Image.fromarray(np.full((112, 160, 3), 200, np.uint8)).save(path)
    bent = replace(circle(1, path=path)[0], distortion=(0.1, 0.0, 0.0, 0.0))
    photo = TrainingPhotos([bent], 1 << 20)[0]
    dark = (photo.pixels == 0).all(axis=2)
    assert 0 < dark.sum() < 112 * 160 / 4
    assert np.array_equal(photo.outside, dark)


def test_every_view_comes_once_in_each_round_and_in_another_order():
    order, rng = ViewOrder(10), default_rng(0)
    rounds = [[order.next(rng) for _ in range(10)] for _ in range(3)]
    assert all(sorted(one) == list(range(10)) for one in rounds)
    assert len({tuple(one) for one in rounds}) == 3


def test_psnr_and_ssim_by_hand():
    photo = default_rng(0).uniform(0, 1, (40, 50, 3)).astype(np.float32)
    assert psnr(photo, photo) == math.inf
    assert psnr(photo + np.float32(0.1), photo) == pytest.approx(20, abs=1e-4)
    assert ssim(photo, photo) == pytest.approx(1)
    flat = np.full((40, 50, 3), 0.5, np.float32)
    half_off = flat.copy()
    half_off[:, :25] = 0.6
    left, outside = np.tile(np.arange(50) < 25, (40, 1)), np.ones((40, 50), bool)
    assert psnr(half_off, flat, left) == math.inf
    assert psnr(half_off, flat, ~left) == pytest.approx(20, abs=1e-4)
    c1 = 1e-4
    expected = (2 * 0.5 * 0.6 + c1) / (0.25 + 0.36 + c1)  # no variance: luminance alone
    outside[5:-5, 5:15] = False
    assert ssim(half_off, flat, outside) == pytest.approx(expected, rel=1e-4)


# --- what people see on the way ---


@pytest.mark.parametrize(
    ("terminal", "quiet", "patience", "ends"),
    [(False, False, 0.0, " left\n"), (True, False, 0.0, ""), (False, True, 0.0, None), (False, False, 60.0, None)],
)
def test_people_are_told_unless_it_is_quiet_or_soon_over(terminal, quiet, patience, ends, capsys, monkeypatch):
    monkeypatch.setattr(progress, "PATIENCE_S", patience)
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal, raising=False)
    with progress.Meter("training", 300, quiet=quiet) as meter:
        for done in (101, 102, 103):
            meter.update(done, "loss 0.1")
    told = capsys.readouterr().err
    if ends is None:
        assert told == ""
    else:
        assert "loss 0.1" in told
        assert told.endswith(ends)
