"""The rivals of the benchmark: they render and differentiate as the rasteriser does, fit, and find things.

On two opaque balls whose masks are right and whose words are unlike, theory leaves nothing between the methods: each
rival has to tell the balls apart as well as the weighted mean does. On stripes of Gaussians that overlap by half, the
mean smears each stripe into the next and a fit of the rendering can undo that: there rivals have to be better.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

torch = pytest.importorskip("torch")

from benchmarks.suite.rivals import FITTED, LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN  # noqa: E402
from benchmarks.suite.rivals.fitting import make  # noqa: E402
from benchmarks.suite.rivals.rasterising import CONTRIBUTORS, Photos, blended, photos_of  # noqa: E402

import drsplat as ds  # noqa: E402
from drsplat.kernels import render_channels, splat_arrays  # noqa: E402
from scenes import gaussians_at, look_at_view, random_gaussians  # noqa: E402
from toy_capture import EYES, HEIGHT, PER_THING, THINGS, WIDTH, balls, masks  # noqa: E402

EFFORTS = {LANGSPLAT: 0.01, LEGAUSSIANS: 0.01, OPENGAUSSIAN: 0.02}  # of the papers' steps


@pytest.fixture(scope="module")
def two_balls() -> tuple[ds.Gaussians, Photos]:
    gaussians, words = balls(), ds.WordEncoder().encode_texts(list(THINGS))
    seen = {}
    for eye in EYES:
        view = replace(look_at_view(eye, width=WIDTH, height=HEIGHT), name=f"{eye}.png")
        seen[view] = ds.ViewFeatures(masks(gaussians, view), words)
    return gaussians, photos_of(gaussians, seen)


def test_what_is_blended_is_what_is_rendered():
    gaussians, view = random_gaussians(40, seed=3), look_at_view((0.0, -6.0, 1.0), width=64, height=48)
    everywhere = np.zeros((view.height, view.width), np.int32)
    embeddings = np.eye(1, 8, dtype=np.float32)
    photos = photos_of(gaussians, {view: ds.ViewFeatures(everywhere, embeddings)})
    values = np.random.default_rng(0).normal(size=(40, 5)).astype(np.float32)
    image, _, _ = render_channels(splat_arrays(gaussians), view, values)
    found = blended(photos.photos[0], torch.from_numpy(values)).numpy()
    assert (photos.photos[0].weights.crow_indices().diff() < CONTRIBUTORS).all(), "nothing is cut off"
    assert_allclose(found, image.reshape(-1, 5), atol=2e-5)


def test_gradients_are_those_of_the_blending():
    """<A x, g> = <x, A^T g> for any x and g."""
    gaussians, view = random_gaussians(60, seed=4), look_at_view((3.0, -5.0, 1.0), width=48, height=40)
    seen = {view: ds.ViewFeatures(np.zeros((40, 48), np.int32), np.eye(1, 8, dtype=np.float32))}
    photo = photos_of(gaussians, seen).photos[0]
    values = torch.randn(60, 3, requires_grad=True)
    rendered = blended(photo, values)
    along = torch.randn_like(rendered)
    rendered.backward(along)
    assert values.grad is not None
    left, right = float((rendered.detach() * along).sum()), float((values.detach() * values.grad).sum())
    assert left == pytest.approx(right, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", FITTED)
def test_a_rival_fits_what_it_says_and_tells_two_balls_apart(name, two_balls):
    gaussians, photos = two_balls
    made = make(name, gaussians, photos, EFFORTS[name])
    for stage, losses in made.losses.items():
        assert np.isfinite(losses).all(), stage
    first, last = (made.losses[next(iter(made.losses))][at] for at in (0, -1))
    assert last < 0.7 * first
    known = np.isfinite(made.features).all(axis=1)
    assert_array_equal(known, photos.seen)
    named = known & (np.nan_to_num(made.features) != 0).any(axis=1)  # leaves of few pixels take no mask's embedding
    assert named.sum() > 0.3 * known.sum()
    cosines = made.features[named] @ ds.WordEncoder().encode_texts(list(THINGS)).T
    assert (cosines.argmax(1) == np.repeat([0, 1], PER_THING)[named]).mean() > 0.97


STRIPES, ROWS, STEP = ("red mug", "blue plate", "green lamp", "old chair", "white sofa", "black door"), 12, 0.2


@pytest.fixture(scope="module")
def stripes() -> tuple[ds.Gaussians, dict[ds.View, ds.ViewFeatures]]:
    """Upright stripes two Gaussians wide, each as wide as it is far from the next; both sides are seen."""
    at = (np.arange(ROWS) - (ROWS - 1) / 2) * STEP
    across, along = (grid.ravel() for grid in np.meshgrid(at, at))
    depths = np.random.default_rng(0).uniform(-0.02, 0.02, ROWS**2)
    gaussians = gaussians_at(np.stack([across, depths, along], 1), (STEP, 0.005, STEP), opacity=0.5)
    words, seen = ds.WordEncoder().encode_texts(list(STRIPES)), {}
    for eye in ((-0.6, -4, 0), (0, -4, 0.5), (0.6, -4, -0.3), (-0.6, 4, 0), (0, 4, 0.5), (0.6, 4, -0.3)):
        view = replace(look_at_view(eye, width=96, height=72, fov_degrees=40), name=f"{eye}.png")
        seen[view] = ds.ViewFeatures(stripes_of(view), words)
    return gaussians, seen


def stripes_of(view: ds.View) -> np.ndarray:
    """Per pixel the stripe that its ray meets in the plane y = 0, or -1."""
    turn, shift = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3]
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    rays = np.linalg.solve(view.K, np.stack([x.ravel(), y.ravel(), np.ones(x.size)])).T @ turn
    eye = -turn.T @ shift
    met = eye - (eye[1] / rays[:, 1])[:, None] * rays
    half = ROWS * STEP / 2
    stripe = np.floor((met[:, 0] + half) / (2 * STEP)).astype(np.int32)
    inside = (np.abs(met[:, [0, 2]]) < half).all(1)
    return np.where(inside, stripe, -1).reshape(x.shape).astype(np.int32)


def found_stripes(features: np.ndarray) -> float:
    """Mean IoU of the stripes with what lies within a cosine of one half of their words."""
    cosines = features @ ds.WordEncoder().encode_texts(list(STRIPES)).T / np.linalg.norm(features, axis=1)[:, None]
    true = np.tile(np.repeat(np.eye(len(STRIPES), dtype=bool), 2, axis=0), (ROWS, 1))
    found = cosines > 0.5
    return float(((found & true).sum(0) / (found | true).sum(0)).mean())


@pytest.mark.slow
@pytest.mark.parametrize("name", [LANGSPLAT, LEGAUSSIANS])
def test_fitting_beats_the_mean_where_gaussians_overlap(name, stripes):
    gaussians, seen = stripes
    registration = ds.register(gaussians, list(seen), {view.name: features for view, features in seen.items()})
    mean = registration.evidence.rows(np.arange(ROWS**2)).features(0, ROWS**2)
    fitted = make(name, gaussians, photos_of(gaussians, seen), 0.02).features
    assert found_stripes(fitted) > found_stripes(mean) + 0.03


@pytest.mark.slow
@pytest.mark.parametrize("name", FITTED)
def test_the_same_fit_gives_the_same_bits(name, two_balls):
    first, second = (make(name, *two_balls, 0.001).features for _ in range(2))
    assert_array_equal(first, second)
