"""The photometric loss and the Adam step against their float64 twins and against torch."""

import importlib.util
from functools import lru_cache

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.errors import InputError
from drsplat.kernels import available_isas
from drsplat.kernels.training import adam_step, photometric_loss
from twins import loss as reference_loss

every_isa = pytest.mark.parametrize("isa", available_isas())
every_weight = pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
SIZES = [(19, 23), (32, 16), (5, 40), (1, 1)]  # smaller than the window, too
oracle = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="the oracle needs torch")


def two_images(height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A smooth picture and a noisy copy; some pixels are equal, some beyond [0, 1]."""
    rng = default_rng(seed)
    rows, columns = np.mgrid[:height, :width]
    waves = np.stack([np.sin(rows / 5 + c) * np.cos(columns / (3 + c)) for c in range(3)], axis=-1)
    target = 0.5 + 0.45 * waves
    image = target + rng.normal(0, 0.15, target.shape) * (rng.random((height, width, 1)) < 0.8)
    return image.astype(np.float32), target.astype(np.float32)


@lru_cache
def twin_of(size: tuple[int, int], weight: float) -> reference_loss.Loss:
    return reference_loss.photometric_loss(*two_images(*size), weight)


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    size = np.abs(expected)
    return float((np.abs(found - expected) / np.maximum(size, 1e-2 * size.max())).max())


@pytest.mark.slow
@every_isa
@every_weight
@pytest.mark.parametrize("size", SIZES)
def test_the_loss_is_that_of_the_twin(size, weight, isa):
    image, target = two_images(*size)
    found = photometric_loss(image, target, weight, isa=isa)
    expected = twin_of(size, weight)
    assert_allclose(found[:3], expected[:3], rtol=0, atol=1e-5)
    assert relative_error(found.gradient, expected.gradient) < 1e-3


@pytest.mark.oracle
@oracle
@every_weight
@pytest.mark.parametrize("size", SIZES)
def test_the_loss_is_that_of_torch(size, weight):
    """The twin's and the native one's, value and gradient, by convolution and autograd in float64."""
    import torch

    import dense_torch

    image, target = two_images(*size)
    leaf = torch.tensor(image.astype(np.float64), requires_grad=True)
    value = dense_torch.photometric_loss(leaf, torch.tensor(target.astype(np.float64)), weight)
    value.backward()
    twin = twin_of(size, weight)
    native = photometric_loss(image, target, weight)
    assert_allclose(twin.value, value.item(), rtol=1e-12)
    assert_allclose(native.value, value.item(), rtol=1e-5)
    assert relative_error(twin.gradient, leaf.grad.numpy()) < 1e-5
    assert relative_error(native.gradient, leaf.grad.numpy()) < 1e-3


def test_a_constant_difference_has_a_closed_form():
    """Within two constant images SSIM is its luminance term; L1 is the difference."""
    image, target = np.full((64, 64, 3), 0.75, np.float32), np.full((64, 64, 3), 0.5, np.float32)
    assert_allclose(photometric_loss(image, target, 0.0).value, 0.25, rtol=1e-6)
    luminance = (2 * 0.75 * 0.5 + 1e-4) / (0.75**2 + 0.5**2 + 1e-4)
    similar = reference_loss.ssim_map(image.astype(np.float64), target.astype(np.float64))
    assert_allclose(similar[5:-5, 5:-5], luminance, rtol=1e-9)
    assert similar[0].max() < luminance  # outside is zero in both
    assert_allclose(photometric_loss(image, target).ssim, similar.mean(), rtol=1e-3)


@every_isa
def test_threads_change_no_bit_of_the_loss(isa):
    image, target = two_images(97, 130)
    once = photometric_loss(image, target, threads=1, isa=isa)
    for threads in (2, 3, 5):
        other = photometric_loss(image, target, threads=threads, isa=isa)
        assert other[:3] == once[:3]
        assert_array_equal(other.gradient, once.gradient)


def test_images_of_two_sizes_are_refused():
    image, target = two_images(20, 30)
    with pytest.raises((InputError, TypeError)):  # TypeError: of the annotations, where checked
        photometric_loss(image, target[:-1])


# --- Adam -----------------------------------------------------------------------------------------


def gradients(steps: int, shape: tuple[int, ...]) -> np.ndarray:
    """Of sizes from 1e-8 to 1e2; some entries never have one."""
    rng = default_rng(0)
    sizes = 10.0 ** rng.uniform(-8, 2, shape) * (rng.random(shape) < 0.9)
    return (rng.normal(size=(steps, *shape)) * sizes).astype(np.float32)


def taken(step, state: list[np.ndarray], grads: np.ndarray, rate: float, **options) -> np.ndarray:
    for i, gradient in enumerate(grads, start=1):
        step(state[0], gradient, state[1], state[2], rate, i, **options)
    return state[0]


@every_isa
@pytest.mark.parametrize("shape", [(7,), (100, 3), (33, 16, 3)])
def test_fifty_steps_are_those_of_the_twin(shape, isa):
    start = default_rng(1).normal(size=shape).astype(np.float32)
    grads, rate = gradients(50, shape), 1e-2
    native = [start.copy(), np.zeros_like(start), np.zeros_like(start)]
    twin = [column.astype(np.float64) for column in native]
    taken(adam_step, native, grads, rate, isa=isa)
    taken(reference_loss.adam_step, twin, grads, rate)
    assert_allclose(native[0], twin[0], rtol=1e-6, atol=1e-6)
    assert_allclose(native[1], twin[1], rtol=1e-4, atol=1e-5 * np.abs(grads).max(axis=0).max())
    still = np.abs(grads).max(axis=0) == 0
    assert_array_equal(native[0][still], start[still])
    assert np.abs(twin[0] - start).max() > 5 * rate


@pytest.mark.slow
@pytest.mark.oracle
@oracle
def test_fifty_steps_are_those_of_torch():
    import torch

    start, grads, rate = np.linspace(-1, 1, 60, dtype=np.float32), gradients(50, (60,)), 3e-3
    leaf = torch.nn.Parameter(torch.tensor(start))
    optimizer = torch.optim.Adam([leaf], lr=rate, eps=1e-15)
    for gradient in grads:
        leaf.grad = torch.tensor(gradient)
        optimizer.step()
    native = [start.copy(), np.zeros_like(start), np.zeros_like(start)]
    taken(adam_step, native, grads, rate)
    assert_allclose(native[0], leaf.detach().numpy(), rtol=1e-6, atol=1e-6)


@every_isa
def test_threads_change_no_bit_of_a_step(isa):
    grads = gradients(3, (50_001, 3))
    states = []
    for threads in (1, 2, 3, 5):
        state = [np.zeros((50_001, 3), np.float32) for _ in range(3)]
        taken(adam_step, state, grads, 1e-3, threads=threads, isa=isa)
        states.append(state)
    for state in states[1:]:
        for ours, theirs in zip(state, states[0], strict=True):
            assert_array_equal(ours, theirs)
    assert np.abs(states[0][0]).max() > 0


@every_isa
@pytest.mark.parametrize("count", [1, 15, 16, 40, 2_003])
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_the_constant_term_has_its_own_rate(count, coefficients, isa):
    grads = gradients(3, (count, coefficients, 3))
    both, constant, rest = ([np.ones_like(grads[0]) for _ in range(3)] for _ in range(3))
    taken(adam_step, both, grads, 1e-3, constant_rate=0.02, isa=isa, threads=2)
    taken(adam_step, constant, grads, 0.02, isa=isa)
    taken(adam_step, rest, grads, 1e-3, isa=isa)
    assert_allclose(both[0][:, 0], constant[0][:, 0], rtol=1e-6)
    assert_array_equal(both[0][:, 1:], rest[0][:, 1:])
    assert_array_equal(both[1], rest[1])
    assert_array_equal(both[2], rest[2])


def test_only_harmonics_have_a_constant_term():
    rows = [np.zeros((10, 6), np.float32) for _ in range(4)]
    with pytest.raises(InputError, match=r"harmonics \(N, K, 3\)"):
        adam_step(*rows, 1e-3, 1, constant_rate=1e-2)


def test_only_arrays_that_can_be_changed_in_place_are_taken():
    whole = np.zeros((10, 6), np.float32)
    for bad in (whole[:, ::2], whole.astype(np.float64), whole[:5]):
        with pytest.raises(InputError):
            adam_step(bad, np.zeros((10, 6), np.float32), whole, whole.copy(), 1e-3, 1)
