"""Pictures of parts of a scene."""

import numpy as np
import pytest

from drsplat.drawing.rendering import render
from drsplat.errors import InputError
from drsplat.kernels import splat_arrays
from scenes import look_at_view, random_gaussians

VIEW = look_at_view((6, 0, 1), width=64, height=48)


def test_a_part_is_rendered_as_if_the_rest_did_not_exist():
    scene = random_gaussians(300, seed=1)
    index = np.arange(0, 300, 3)
    alone = render(scene.subset(index), VIEW)
    for select in (index, np.arange(300) % 3 == 0):
        part = render(scene, VIEW, select=select)
        assert np.array_equal(part.rgb, alone.rgb)
        assert np.array_equal(part.alpha, alone.alpha)
    assert np.array_equal(render(scene, VIEW, splats=splat_arrays(scene)).rgb, render(scene, VIEW).rgb)


def test_nothing_shows_the_background():
    picture = render(random_gaussians(10), VIEW, select=np.zeros(10, bool), background=(0.1, 0.2, 0.3))
    assert np.allclose(picture.rgb, [0.1, 0.2, 0.3])
    assert not picture.alpha.any()
    assert not picture.depth.any()


def test_values_are_composited_like_colours():
    scene = random_gaussians(300, seed=2, sh_degree=0)
    colors = np.maximum(0, 0.5 + 0.28209479177387814 * scene.sh[:, 0])
    picture = render(scene, VIEW, values=np.hstack([colors, np.ones((300, 1), np.float32)]))
    np.testing.assert_allclose(picture.channels[..., :3], picture.rgb, atol=1e-6)
    np.testing.assert_allclose(picture.channels[..., 3], picture.alpha, atol=1e-5)


def test_values_of_another_scene_are_refused():
    with pytest.raises(InputError, match="expected 10 rows"):
        render(random_gaussians(10), VIEW, values=np.ones((9, 1), np.float32))
