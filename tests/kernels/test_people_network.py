"""The network that finds people, against its twin."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.kernels import photo_regions
from drsplat.kernels.photo_regions import Layers
from drsplat.kernels.splats import available_isas
from drsplat.photos.models.people.finding import shipped_layers
from refusing import refused
from twins import people_network

every_isa = pytest.mark.parametrize("isa", available_isas())
SIZES = (5, 3, 6, 6, 7, 7, 7, 8, 8, 8, 8, 9, 9, 9, 10, 10, 10, 11)  # channels: the first, then after each block


def made_up_layers() -> Layers:
    """A small network of the same form, whose channels fill no block of outputs."""
    rng = np.random.default_rng(0)
    shapes = [(27, SIZES[0])]
    for block, (before, after) in enumerate(pairwise(SIZES)):
        wide = 2 * before if block else before
        shapes += [(before, wide)] if block else []
        shapes += [(9, wide), (wide, after)]
    shapes += [(SIZES[-1], 6), (SIZES[-1], 5), (11, 7), (7, 21)]
    weights = [rng.standard_normal(shape) * 1.5 / shape[0] ** 0.5 for shape in shapes]
    biases = [rng.standard_normal(shape[1]) / 4 for shape in shapes]
    weights[-1] *= 0.1
    biases[-1][people_network.PERSON] += 3  # as likely as all 20 others
    return tuple(part.astype(np.float32) for pair in zip(weights, biases, strict=True) for part in pair)


def noise(seed: int, height: int, width: int) -> np.ndarray:
    blots = np.random.default_rng(seed).integers(0, 256, (height // 8 + 1, width // 8 + 1, 3), np.uint8)
    return blots.repeat(8, 0).repeat(8, 1)[:height, :width]


@every_isa
@pytest.mark.parametrize("size", [(33, 49), (1, 17), (17, 1), (1, 1), (65, 129)])
def test_people_are_the_twins(isa, size):
    image, layers = noise(1, *size), made_up_layers()
    found = photo_regions.people(image, layers, isa=isa)
    assert_allclose(found, people_network.people(image, layers), atol=1e-4)
    assert_array_equal(found, photo_regions.people(image, layers, threads=3, isa=isa))
    if min(size) > 30:
        assert found.std() > 0.01


def test_the_shipped_network_is_the_twins():
    image = noise(2, 49, 65)
    assert_allclose(
        photo_regions.people(image, shipped_layers()), people_network.people(image, shipped_layers()), atol=1e-3
    )


@pytest.mark.parametrize("shape", [(32, 33, 3), (33, 16, 3), (0, 17, 3)])
def test_other_sides_are_refused(shape):
    with refused("network: expected"):
        photo_regions.people(np.zeros(shape, np.uint8), made_up_layers())


@pytest.mark.parametrize("cut", [slice(2, None), slice(None, -2), slice(0, 0), slice(None, None, -1)])
def test_layers_that_do_not_fit_are_refused(cut):
    with refused("network: expected"):
        photo_regions.people(noise(0, 17, 17), made_up_layers()[cut])
