"""Real trained scenes through the whole pipeline."""

from pathlib import Path

import numpy as np
import pytest
from skimage.color import rgb2lab

import drsplat as ds
from known_parts import divide, search_parts
from splat_captures import BACKDROP, COLOURS, ColourEncoder, orbit, write_capture

ROOT = Path(__file__).resolve().parents[2]
SPLATS = ROOT.parent / "shared" / "data" / "splats"
UP = np.array([0.0, -1.0, 0.0])

THRESHOLD = 0.5

pytestmark = [pytest.mark.data, pytest.mark.skipif(not SPLATS.is_dir(), reason="the shared real splats are not here")]


@pytest.fixture(scope="module")
def guitar() -> ds.Gaussians:
    return ds.read_gaussians(SPLATS / "guitar.compressed.ply")


@pytest.fixture(scope="module")
def capture(guitar, tmp_path_factory) -> Path:
    """Photos, cameras.json and features of the guitar, as files."""
    folder = tmp_path_factory.mktemp("guitar")
    write_capture(folder, guitar, orbit(guitar, UP, 15, 400))
    return folder


@pytest.fixture(scope="module")
def field(guitar, capture) -> ds.LanguageField:
    """Registered from those files, saved and loaded."""
    features = ds.read_features(capture / "features", encoder=ColourEncoder.identity)
    registration = ds.register(guitar, ds.read_views(capture), features)
    registration.to_field().save(capture / "scene.field")
    return ds.load_field(capture / "scene.field")


def ask(field: ds.LanguageField, name: str) -> np.ndarray:
    """Of each registered Gaussian: high where the colour fits, and fits better than the others."""
    others = [other for other in COLOURS if other != name]
    scene = ds.Scene(field, encoder=ColourEncoder())
    answer = scene.ask(ds.Query(name, negatives=tuple(others)))
    return np.minimum(answer.scores, answer.values)


@pytest.mark.slow
def test_parts_of_a_real_scene_are_found_again(guitar):
    views = orbit(guitar, UP, 18, 320)
    parts = divide(guitar, 12)
    findings = search_parts(guitar, views, parts)
    registered = findings.field.gaussian_ids
    assert findings.registration.num_registered > 0.8 * len(guitar)
    assert findings.ious.mean() > 0.92
    assert findings.ious.min() > 0.8
    inside = parts.margin[registered] > 2 * guitar.scales[registered].max(1)
    assert inside.mean() > 0.5
    assert findings.wrong[inside].mean() < 0.01


def test_the_cameras_show_the_whole_scene_upright(guitar):
    for view in orbit(guitar, UP, 6, 200):
        alpha = ds.render(guitar, view).alpha
        border = np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
        assert border.max() < 0.2
        assert 0.6 < (alpha > 0.5).any(axis=1).mean() < 1
        thin, thick = np.array_split((alpha > 0.5).sum(axis=1), 2)
        assert thin.sum() < thick.sum()  # the neck is above the body


def test_files_hold_what_was_rendered(guitar, capture):
    views = {view.name: view for view in orbit(guitar, UP, 15, 400)}
    read = ds.read_views(capture)
    assert [view.name for view in read] == sorted(views)
    for view in read[::5]:
        np.testing.assert_allclose(view.cam_from_world, views[view.name].cam_from_world, atol=1e-9)
        drawn = ds.render(guitar, view, background=(BACKDROP,) * 3).rgb
        assert np.abs(ds.load_image(view) / 255 - drawn.clip(0, 1)).max() <= 0.5001 / 255 + 1e-6


@pytest.mark.parametrize("colour", ["brown", "yellow", "black", "grey"])
def test_what_is_found_has_the_colour_that_was_asked_for(guitar, capture, field, colour):
    scores = ask(field, colour)
    chosen = np.zeros((len(guitar), 1), np.float32)
    chosen[field.gaussian_ids[scores > THRESHOLD]] = 1
    pixels = []
    for view in ds.read_views(capture)[::2]:
        share = ds.render(guitar, view, values=chosen).channels[..., 0]
        pixels.append(ds.load_image(view)[share > 0.7])
    names = list(COLOURS)
    wanted = rgb2lab(np.array(list(COLOURS.values())) / 255)
    lab = rgb2lab(np.concatenate(pixels) / 255)
    assert len(lab) > 300
    nearest = np.linalg.norm(lab[:, None] - wanted, axis=-1).argmin(axis=1)
    assert (nearest == names.index(colour)).mean() > 0.7


@pytest.mark.parametrize("colour", ["green", "blue", "red"])
def test_a_colour_that_is_not_there_is_not_found(guitar, field, colour):
    scores = ask(field, colour)
    assert (scores > THRESHOLD).sum() < 0.001 * len(guitar)


def test_one_scene_in_two_formats_looks_the_same():
    scenes = [ds.read_gaussians(SPLATS / f"biker.{suffix}") for suffix in ("spz", "compressed.ply")]
    view = orbit(scenes[0], UP, 3, 300)[1]
    spz, ply = (ds.render(scene, view) for scene in scenes)
    assert spz.alpha.max() > 0.99
    assert np.abs(spz.rgb - ply.rgb).mean() < 0.002
    assert np.abs(spz.alpha - ply.alpha).max() < 0.15
