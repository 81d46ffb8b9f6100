"""The native training kernels against their float64 twins, and both against torch's autograd.

Where float32 may rightly decide otherwise than float64 (the boundary band), the image gradient is set to
zero, so that both sides differentiate the same function. Errors are relative to the entry itself, of a
position or quaternion to the largest of the Gaussian's own, or to a hundredth of the largest of its kind where
that is smaller.
"""

import importlib.util
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.drawing.rendering import render
from drsplat.kernels import available_isas, splat_arrays
from drsplat.kernels.training import Gradients, HarmonicsStep, SceneParameters, adam_step, forward
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.views import View
from refusing import refused
from scenes import look_at_view, random_gaussians
from twins import gradients as reference_gradients
from twins import registering as reference
from twins import training as reference_training
from twins.training import Parameters

TOLERANCE = 1e-3
KINDS = ("means", "log_scales", "quats", "logits", "sh", "screen")
VECTORS = ("means", "quats")  # the small entry of a large one is a difference of large sums
INSIDE = {"target": (1.0, 0.3, 0.1), "fov_degrees": 90.0}


class Case(NamedTuple):
    count: int
    sh_degree: int
    eye: tuple[float, float, float]
    options: dict
    background: tuple[float, float, float] = (0.2, 0.5, 0.9)
    antialiased: bool = False
    size: float = 0.3


CASES = {
    "outside": Case(120, 0, (0.0, -5.0, 1.0), {"width": 48, "height": 40}),
    "off-centre": Case(100, 1, (3.0, -3.0, 2.0), {"width": 48, "height": 40, "principal": (15.0, 28.0)}),
    "inside": Case(150, 2, (0.1, 0.2, 0.0), {"width": 48, "height": 40, **INSIDE}),
    "black": Case(60, 3, (0.0, -3.5, 0.5), {"width": 45, "height": 37}, (0.0, 0.0, 0.0)),
    "antialiased": Case(150, 1, (0.0, -3.5, 0.5), {"width": 45, "height": 37}, antialiased=True, size=0.1),
}
every_case = pytest.mark.parametrize("case", CASES)
every_isa = pytest.mark.parametrize("isa", available_isas())


def parameters_of(gaussians: Gaussians, seed: int = 0) -> SceneParameters:
    """Before activation: quaternions of any length, a fifth of the Gaussians nearly opaque."""
    rng = default_rng(seed)
    opacities = gaussians.opacities.astype(np.float64).clip(1e-3, 0.999)
    logits = np.log(opacities / (1 - opacities))
    logits[rng.random(len(logits)) < 0.2] = 6.0
    quats = gaussians.quats * np.exp(rng.normal(0, 0.5, (len(logits), 1)))
    columns = (gaussians.means, np.log(gaussians.scales), quats, logits, gaussians.sh)
    return SceneParameters(*(np.ascontiguousarray(c, np.float32) for c in columns))


def random_scene(count: int, seed: int, sh_degree: int, size: float = 0.3) -> SceneParameters:
    scene = random_gaussians(count, seed, extent=1.5, size=size, sh_degree=sh_degree)
    return parameters_of(scene, seed)


@lru_cache
def scene_of(case: str) -> SceneParameters:
    return random_scene(CASES[case].count, list(CASES).index(case), CASES[case].sh_degree, CASES[case].size)


@lru_cache
def view_of(case: str) -> View:
    return look_at_view(CASES[case].eye, **CASES[case].options)


def background_of(case: str) -> np.ndarray:
    return np.array(CASES[case].background, np.float32)


@lru_cache
def decisions_of(case: str) -> reference_training.Decisions:
    given = Parameters(*scene_of(case)), view_of(case), CASES[case].sh_degree
    return reference_training.decide(*given, antialiased=CASES[case].antialiased)


@lru_cache
def image_gradient_of(case: str) -> np.ndarray:
    view = view_of(case)
    return off_the_boundary(decisions_of(case).unsure, view)


def off_the_boundary(unsure: np.ndarray, view: View, seed: int = 0) -> np.ndarray:
    """A random image gradient, zero where float32 may decide otherwise."""
    values = default_rng(seed).normal(size=(view.height, view.width, 3))
    return (values * ~unsure[..., None]).astype(np.float32)


@lru_cache
def slopes_of(case: str) -> reference_gradients.Gradients:
    """The finite differences."""
    given = Parameters(*scene_of(case)), view_of(case), CASES[case].sh_degree, background_of(case)
    return reference_gradients.gradients(*given, image_gradient_of(case), CASES[case].antialiased)


def native_pass(case: str, **options):
    given = scene_of(case), view_of(case), CASES[case].sh_degree, background_of(case)
    return forward(*given, antialiased=CASES[case].antialiased, **options)


def twin_image(case: str, background: np.ndarray) -> np.ndarray:
    given = Parameters(*scene_of(case)), view_of(case), CASES[case].sh_degree, background, decisions_of(case)
    return reference_training.image(*given, CASES[case].antialiased)


def relative_error(kind: str, found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    assert found.shape == expected.shape
    size = np.abs(expected)
    if kind in VECTORS:
        size = size.max(axis=1, keepdims=True, initial=0)
    return np.abs(found - expected) / np.maximum(size, 1e-2 * size.max() + 1e-300)


def assert_gradients_agree(found, expected, tolerance: float = TOLERANCE) -> None:
    """All kinds that `expected` has; every wrong kind is named with its worst entry."""
    wrong = []
    for kind in KINDS:
        ours, theirs = np.asarray(getattr(found, kind)), np.asarray(getattr(expected, kind))
        error = relative_error(kind, ours, theirs)
        place = np.unravel_index(error.argmax(), error.shape)
        if not error.max() <= tolerance:
            place_of = tuple(map(int, place))
            wrong.append(
                f"{kind}{place_of}: {ours[place]:.7g}, expected {theirs[place]:.7g}; "
                f"{(error > tolerance).sum()} of {error.size} over {tolerance:g}"
            )
    assert not wrong, "\n".join(wrong)


# --- the twin ------------------------------------------------------------------------------------


def test_the_cases_hold_every_rule():
    """Else the comparisons below would prove less than they seem to."""
    capped = dark = clamped = stopped = 0
    for case in CASES:
        entries, branches, unsure = decisions_of(case)
        seen = np.unique(entries.ids)
        capped += entries.capped.sum()
        dark += (~branches.lit[seen]).sum()
        clamped += np.abs(branches.sides[seen]).sum()
        image = twin_image(case, background_of(case) * 0 + 1e6)
        stopped += (image < 1e6 * 2e-4).sum()
        assert unsure.mean() < 0.03
        assert len(seen) > 40
    assert min(capped, dark, clamped, stopped) > 10


@every_case
def test_held_decisions_change_no_image(case):
    """With the parameters they were taken for, the image is that of the compositing twin."""
    view, gaussians = view_of(case), activated(case)
    image = twin_image(case, background_of(case))
    colors = reference.sh_colors(gaussians.sh, gaussians.means, view.center)
    expected = reference.render_channels(splat_arrays(gaussians), view, colors, background_of(case)).channels
    sure = ~decisions_of(case).unsure
    assert_allclose(image[sure], expected[sure], rtol=0, atol=2e-5)  # theirs activated in float32


def activated(case: str) -> Gaussians:
    wide = [column.astype(np.float64) for column in scene_of(case)]
    quats = wide[2] / np.linalg.norm(wide[2], axis=1, keepdims=True)
    columns = (wide[0], quats, np.exp(wide[1]), 1 / (1 + np.exp(-wide[3])), wide[4])
    return Gaussians(*(column.astype(np.float32) for column in columns), antialiased=CASES[case].antialiased)


# --- the image and its gradient -------------------------------------------------------------------


@pytest.mark.slow
@every_case
@every_isa
def test_gradients_are_those_of_finite_differences(case, isa):
    found = native_pass(case, isa=isa).backward(image_gradient_of(case))
    assert_gradients_agree(found, slopes_of(case))


@every_case
@every_isa
def test_the_image_is_that_of_the_twin(case, isa):
    view = native_pass(case, isa=isa)
    expected = twin_image(case, background_of(case))
    sure = ~decisions_of(case).unsure
    assert_allclose(view.image[sure], expected[sure], rtol=0, atol=1e-5)


@every_case
def test_the_image_is_that_of_render(case):
    """Both activated in float32, so that not one decision differs."""
    view = native_pass(case)
    picture = render(activated(case), view_of(case), background=CASES[case].background)
    sure = ~decisions_of(case).unsure
    assert_allclose(view.image[sure], picture.rgb[sure], rtol=0, atol=1e-6)
    assert_allclose(view.alpha[sure], picture.alpha[sure], rtol=0, atol=1e-6)


@every_case
def test_radii_are_those_of_the_projection(case):
    """Three standard deviations along the long axis, rounded up; 0 where nothing is seen."""
    found = native_pass(case).backward(image_gradient_of(case))
    entries, branches, _ = decisions_of(case)
    scene = Parameters(*(column.astype(np.float64) for column in scene_of(case)))
    marks = reference_training.footprints(scene, view_of(case), 0, branches)
    a, b, c = marks.covariances.T
    mid = 0.5 * (a + c)
    reach = 3 * np.sqrt(mid + np.sqrt(np.maximum(0.1, mid * mid - (a * c - b * b))))
    seen = np.unique(entries.ids)
    sure = seen[np.abs(reach[seen] - np.round(reach[seen])) > 1e-3]
    assert len(sure) > 0.9 * len(seen)
    assert_array_equal(found.radii[sure], np.ceil(reach[sure]))
    points = scene.means @ view_of(case).cam_from_world[2, :3] + view_of(case).cam_from_world[2, 3]
    assert_array_equal(found.radii[points < 0.2], 0)
    assert set(np.flatnonzero(found.screen)) <= set(np.flatnonzero(found.radii))


@pytest.mark.parametrize("active", [0, 1, 2])
def test_degrees_beyond_the_active_one_do_nothing(active):
    scene, view = random_scene(60, 3, 3), view_of("black")
    cut = scene._replace(sh=np.ascontiguousarray(scene.sh[:, : (active + 1) ** 2]))
    black = np.zeros(3, np.float32)
    full, short = forward(scene, view, active, black), forward(cut, view, active, black)
    assert_array_equal(full.image, short.image)
    gradient = off_the_boundary(np.zeros((view.height, view.width), bool), view)
    ours, theirs = full.backward(gradient), short.backward(gradient)
    beyond = (active + 1) ** 2
    assert_array_equal(ours.sh[:, beyond:], 0)
    assert_array_equal(ours.sh[:, :beyond], theirs.sh)
    assert np.abs(theirs.sh).max() > 0
    for kind in set(KINDS) - {"sh"}:
        assert_array_equal(getattr(ours, kind), getattr(theirs, kind))


@every_isa
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_harmonics_step_on_the_way_back_as_they_do_after_it(degree, isa):
    """Unseen ones as well, with the same bits for any threads; coefficients beyond the degree take no step."""
    scene, view, black = random_scene(60, 3, 3), view_of("outside"), np.zeros(3, np.float32)
    scene.means[::3] *= 1000
    used = slice((degree + 1) ** 2)
    moments = [default_rng(seed).uniform(0.1, 1, scene.sh.shape).astype(np.float32) for seed in (1, 2)]
    after = [column.copy() for column in (scene.sh, *moments)]
    gradients = forward(scene, view, degree, black, isa=isa).backward(image_gradient_of("outside"))
    assert not gradients.sh.any(axis=(1, 2)).all()
    adam_step(after[0], gradients.sh, *after[1:], 1e-3, 7, constant_rate=2e-2, isa=isa)
    by_threads = []
    for threads in (1, 2, 5):
        at_once = [column.copy() for column in (scene.sh, *moments)]
        drawn = forward(scene._replace(sh=at_once[0]), view, degree, black, threads=threads, isa=isa)
        others = drawn.backward(image_gradient_of("outside"), HarmonicsStep(*at_once[1:], 1e-3, 2e-2, 7))
        assert others.sh.shape == (60, 0, 3)
        for one, other, start in zip(at_once, after, (scene.sh, *moments), strict=True):
            assert_allclose(one[:, used], other[:, used], rtol=1e-6, atol=1e-6)
            assert_array_equal(one[:, used.stop :], start[:, used.stop :])
        for kind in set(KINDS) - {"sh"}:
            assert_array_equal(getattr(others, kind), getattr(gradients, kind))
        by_threads.append(at_once)
    for others in by_threads[1:]:
        assert_array_equal(others, by_threads[0])
    assert (after[0] != scene.sh)[:, used].all()


def test_moments_of_another_size_are_refused():
    drawn = native_pass("outside")
    other = np.zeros((3, 4, 3), np.float32)
    with refused("expected moments"):
        drawn.backward(image_gradient_of("outside"), HarmonicsStep(other, other, 1e-3, 1e-3, 1))


def test_gradients_outlive_their_pass():
    """Memory that later passes take again must not be theirs."""
    first = native_pass("outside").backward(image_gradient_of("outside"))
    kept = [column.copy() for column in first]
    for factor in np.float32([2, 3]):
        native_pass("outside").backward(factor * image_gradient_of("outside"))
    for column, copy in zip(first, kept, strict=True):
        assert_array_equal(column, copy)


def test_what_is_not_seen_has_no_gradient():
    scene = scene_of("outside")
    away = look_at_view((0.0, -5.0, 1.0), (0.0, -9.0, 1.0), width=48, height=40)
    view = forward(scene, away, 0, np.float32([0.25, 0.5, 0.75]))
    assert_array_equal(view.image, np.broadcast_to(np.float32([0.25, 0.5, 0.75]), (40, 48, 3)))
    assert_array_equal(view.alpha, 0)
    found = view.backward(np.ones((40, 48, 3), np.float32))
    for column in found:
        assert_array_equal(column, 0)


def extreme_columns(view: View) -> list[np.ndarray]:
    """What an optimiser may run into: collapsed, huge, faint, opaque, behind or in the camera."""
    columns = [column.copy() for column in random_scene(200, 7, 3)]
    means, log_scales, quats, logits, sh = columns
    quats[0:5], quats[5:10], quats[10:15] = 0, 1e-12 * quats[5:10], 1e12 * quats[10:15]
    logits[15:20], logits[20:25], logits[25:30], logits[30:35] = 50, -50, 200, -200
    log_scales[35:40], log_scales[40:45], log_scales[45:50] = -100, -30, 30
    log_scales[50:55], log_scales[55:60] = [5, -12, -12], 8
    means[60:65], means[65:70], means[70:75] = view.center, view.center + 1e-4, 1e10
    sh[75:80], sh[80:85] = 1e10, -1e10
    return columns


def test_extreme_parameters_give_finite_gradients():
    view = view_of("black")
    columns = extreme_columns(view)
    found = forward(SceneParameters(*columns), view, 3, np.zeros(3, np.float32))
    assert np.isfinite(found.image).all()
    for name, column in found.backward(image_gradient_of("black"))._asdict().items():
        assert np.isfinite(column).all(), name
        assert np.any(column), name


def test_no_gaussians_at_all():
    scene, view = random_scene(1, 0, 1), view_of("outside")
    empty = SceneParameters(*(column[:0] for column in scene))
    found = forward(empty, view, 1, np.float32([0.25, 0.5, 0.75]))
    assert_array_equal(found.image[7, 9], [0.25, 0.5, 0.75])
    shapes = [column.shape for column in found.backward(np.ones_like(found.image))]
    assert shapes == [(0, 3), (0, 3), (0, 4), (0,), (0, 4, 3), (0,), (0,)]


@lru_cache
def crowd() -> tuple[SceneParameters, View]:
    scene = parameters_of(random_gaussians(3000, 5, sh_degree=2), 5)
    return scene, look_at_view((0.5, -4.0, 1.0), width=150, height=110)


def crowd_gradients(**options) -> tuple[np.ndarray, Gradients]:
    scene, view = crowd()
    found = forward(scene, view, 2, np.float32([0.1, 0.2, 0.3]), **options)
    rng = default_rng(0)
    gradient = rng.normal(size=(view.height, view.width, 3)).astype(np.float32)
    return np.dstack([found.image, found.alpha]), found.backward(gradient)


@every_isa
def test_threads_change_no_bit(isa):
    image, gradients = crowd_gradients(threads=1, isa=isa)
    for threads in (2, 3, 5):
        other_image, other = crowd_gradients(threads=threads, isa=isa)
        assert_array_equal(other_image, image)
        for ours, theirs in zip(other, gradients, strict=True):
            assert_array_equal(ours, theirs)


# --- torch ----------------------------------------------------------------------------------------


def autograd(scene, view, sh_degree, background, image_gradient, antialiased) -> reference_gradients.Gradients:
    """The gradients of the dense rasterizer in float64; in the way of the kernels."""
    import torch

    import dense_torch

    leaves = dense_torch.Scene(*(torch.tensor(c.astype(np.float64), requires_grad=True) for c in scene))
    behind = torch.tensor(background.astype(np.float64))
    dense = dense_torch.render(leaves, view, sh_degree, behind, antialiased)
    (dense.image * torch.tensor(image_gradient.astype(np.float64))).sum().backward()
    half_size = 0.5 * np.array([view.width, view.height])
    screen = np.linalg.norm(dense.offsets.grad.numpy() * half_size, axis=1)
    slopes = [np.zeros(leaf.shape) if leaf.grad is None else leaf.grad.numpy() for leaf in leaves]
    return reference_gradients.Gradients(*slopes, screen)


oracle = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="the oracle needs torch")


@pytest.mark.slow
@pytest.mark.oracle
@oracle
@every_case
def test_finite_differences_are_those_of_autograd(case):
    """The twin and torch, both in float64: two ways to the truth."""
    expected = autograd(
        scene_of(case), view_of(case), CASES[case].sh_degree, background_of(case), image_gradient_of(case),
        CASES[case].antialiased,
    )  # fmt: skip
    assert_gradients_agree(slopes_of(case), expected, 3e-5)


@pytest.mark.oracle
@oracle
@pytest.mark.parametrize("seed", range(24))
def test_gradients_are_those_of_autograd(seed):
    """Random scenes, sizes, lenses and backgrounds; a camera somewhere in or about the scene."""
    rng = default_rng(seed)
    width, height = (int(n) for n in rng.integers(17, 60, 2))
    view = look_at_view(
        rng.uniform(-3, 3, 3),
        rng.uniform(-0.7, 0.7, 3),
        width=width,
        height=height,
        fov_degrees=rng.uniform(30, 100),
        principal=tuple(rng.uniform(0.3, 0.7, 2) * (width, height)),
    )
    degree, antialiased = int(rng.integers(0, 4)), bool(seed % 2)
    scene = random_scene(int(rng.integers(20, 200)), seed, 3)
    unsure = reference_training.decide(Parameters(*scene), view, degree, antialiased=antialiased).unsure
    image_gradient = off_the_boundary(unsure, view, seed)
    background = rng.random(3).astype(np.float32)
    expected = autograd(scene, view, degree, background, image_gradient, antialiased)
    for isa in available_isas():
        found = forward(scene, view, degree, background, antialiased=antialiased, isa=isa).backward(image_gradient)
        assert_gradients_agree(found, expected)
