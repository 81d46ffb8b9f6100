"""Constant colours in bytes: which are clamped, what is shown of them, and the nearest ones that survive."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from command_line import answer_of, text_of
from drsplat import Gaussians, write_gaussians
from drsplat.scene.eight_bits import MAX_ABS_CONSTANT, clamped_in_bytes, fitted_to_8_bits
from drsplat.scene.gaussians import SH_C0
from drsplat.scene.similarity import sh_basis
from scenes import random_gaussians

SH_C1 = 0.4886025119029199  # of the harmonics of degree 1


def of_colors(*colors: float, degree: int = 0) -> Gaussians:
    """Grey Gaussians of these constant colours."""
    scene = random_gaussians(len(colors), sh_degree=degree)
    sh = np.zeros_like(scene.sh)
    sh[:, 0] = ((np.array(colors) - 0.5) / SH_C0)[:, None]
    return replace(scene, sh=sh)


def constants(scene: Gaussians) -> np.ndarray:
    return np.asarray(0.5 + SH_C0 * scene.sh[:, 0].astype(np.float64))


def shown(scene: Gaussians, directions: np.ndarray) -> np.ndarray:
    """Return what such a viewer shows of each Gaussian in each direction, by the definition."""
    rest = np.einsum("dk,nkc->ndc", sh_basis(directions)[:, 1 : scene.sh.shape[1]], scene.sh[:, 1:].astype(np.float64))
    return np.clip(np.rint(np.clip(constants(scene), 0, 1) * 255)[:, None] / 255 + rest, 0, 1)


def unit_vectors(count: int, seed: int = 5) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def test_a_byte_holds_colors_from_zero_to_one_and_what_rounding_makes_of_the_rest():
    marked = clamped_in_bytes(of_colors(0, 1, 0.3, 1.001, -0.001, 1.003, -0.003, 2))
    assert marked.tolist() == [False] * 5 + [True] * 3
    one_channel = of_colors(0.5)
    one_channel.sh[0, 0, 2] = 2.5
    assert clamped_in_bytes(one_channel).tolist() == [True]


def test_what_fits_stays_to_the_bit_and_the_rest_fits_then():
    scene = random_gaussians(500, sh_degree=3)
    scene = replace(scene, sh=4 * scene.sh)
    marked, fitted = clamped_in_bytes(scene), fitted_to_8_bits(scene)
    assert 0.1 < marked.mean() < 0.9
    assert_array_equal(fitted.sh[~marked], scene.sh[~marked])
    assert not clamped_in_bytes(fitted).any()
    assert np.abs(fitted.sh[marked, 0]).max() <= np.float32(MAX_ABS_CONSTANT)
    assert fitted.fingerprint == scene.fingerprint


def test_without_harmonics_a_color_is_cut():
    fitted = fitted_to_8_bits(of_colors(1.7, -0.4, 0.6))
    assert_allclose(constants(fitted)[:, 0], [1, 0, 0.6], atol=1e-6)
    white = fitted_to_8_bits(of_colors(1.7, degree=1))
    assert_allclose(white.sh[0, 1:], 0, atol=1e-12)


def test_an_excess_goes_into_the_harmonics():
    """1.3 + 0.4 z is seen as white but for where z < -0.75; cut, it would be 1 + 0.4 z, too dark by 0.3."""
    scene = of_colors(1.3, degree=1)
    scene.sh[0, 2] = 0.4 / SH_C1
    directions = unit_vectors(2000)
    wanted = np.clip(1.3 + 0.4 * directions[:, 2], 0, 1)
    cut, fitted = (np.abs(shown(one, directions)[0, :, 0] - wanted) for one in (scene, fitted_to_8_bits(scene)))
    assert cut.max() == pytest.approx(0.3, abs=0.01)
    assert fitted.max() < 0.1
    assert (fitted**2).mean() < 0.05 * (cut**2).mean()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_fit_is_never_worse_than_a_cut(degree):
    scene = random_gaussians(400, sh_degree=degree)
    scene = replace(scene, sh=3 * scene.sh).subset(clamped_in_bytes(replace(scene, sh=3 * scene.sh)))
    directions = unit_vectors(4000)
    rest = np.einsum("dk,nkc->ndc", sh_basis(directions)[:, : scene.sh.shape[1]], scene.sh)
    wanted = np.clip(0.5 + rest, 0, 1)
    cut, fitted = (
        ((shown(one, directions) - wanted) ** 2).mean(axis=(1, 2)) for one in (scene, fitted_to_8_bits(scene))
    )
    assert (fitted <= cut + 1e-3).all()
    assert fitted.mean() < 0.6 * cut.mean()


def test_inspect_says_how_many_are_clamped(tmp_path, capsys):
    write_gaussians(tmp_path / "scene.ply", of_colors(0.2, 1.4, 0.9, -0.3, 0.5, 0.5, 0.5, 0.5))
    assert answer_of(capsys, "inspect", tmp_path / "scene.ply")["clamped_colors"] == 0.25
    assert "clamped colors  25.0% of Gaussians, in viewers" in text_of(capsys, "inspect", tmp_path / "scene.ply")
