"""The native half of `graph` against its twins: colours, small regions, what the network sees, sums over regions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from skimage.segmentation import felzenszwalb, watershed
from test_views_hostile import unchecked_types

from drsplat.kernels import available_isas, photo_regions
from drsplat.kernels.photo_regions import (
    AREA,
    AROUND,
    BORDER_STEPS,
    FRAME,
    HISTOGRAM,
    LAB_STEPS,
    LENGTH,
    MAX_TRAIT,
    SEEN,
    STEP,
    TRAIT,
    TRAIT_SQUARE,
    TRAIT_STEP,
    TRAITS,
    Sight,
)
from drsplat.photos.models.graph.segmenter import layers_of, shipped_network
from refusing import refused
from twins import photo_network
from twins import photo_regions as twin

LAYERS = layers_of(shipped_network()[0])
every_isa = pytest.mark.parametrize("isa", available_isas())
few = settings(derandomize=True, max_examples=40)
SEEDS = st.integers(0, 10**6)


def colors(seed: int, height: int, width: int, steps: int) -> np.ndarray:
    return default_rng(seed).integers(0, steps, (height, width, 3)).astype(np.int32)


def photo(seed: int, height: int, width: int) -> np.ndarray:
    """Cells of a few colours and noise."""
    rng = default_rng(seed)
    cells = rng.integers(0, 256, (-(-height // 9), -(-width // 9), 3)).repeat(9, 0).repeat(9, 1)
    return np.clip(cells[:height, :width] + rng.integers(-9, 10, (height, width, 3)), 0, 255).astype(np.uint8)


# Colours


@every_isa
def test_colours_are_those_of_scikit_image(isa):
    """To the step, as they are for all 2^24 of them."""
    greys = np.arange(256, dtype=np.uint8).repeat(3).reshape(1, -1, 3)
    for image in (greys, default_rng(0).integers(0, 256, (512, 512, 3), np.uint8)):
        found = photo_regions.lab_colors(image, isa=isa)
        assert_array_equal(found, twin.lab_colors(image))
        assert_array_equal(found, photo_regions.lab_colors(image, threads=3, isa=isa))


# Small regions


@few
@given(SEEDS, st.integers(1, 30), st.integers(1, 30), st.sampled_from([2, 40, 1600]), st.sampled_from([0.1, 2.0, 60.0]))
def test_small_regions_are_the_twins(seed, height, width, steps, scale):
    """Of few colours many neighbours differ equally, so that their order decides."""
    lab = colors(seed, height, width, steps)
    least = seed % 9
    assert_array_equal(photo_regions.small_regions(lab, scale, least), twin.small_regions(lab, scale, least))


@few
@given(SEEDS, st.integers(1, 20), st.integers(1, 20), st.sampled_from([1, 3, 4000]), st.integers(0, 9))
def test_a_watershed_is_the_twins_and_that_of_scikit_image(seed, height, width, steps, count):
    """Of few heights many pixels are reached at once, so that their order decides."""
    rng = default_rng(seed)
    heights = rng.integers(0, steps, (height, width)).astype(np.int32)
    markers = np.zeros((height, width), np.int32)
    markers[rng.integers(0, height, count), rng.integers(0, width, count)] = np.arange(1, count + 1)
    found = photo_regions.flooded(heights, markers)
    assert_array_equal(found, twin.flooded(heights, markers))
    if count and steps == 4000:
        assert (found == watershed(heights, markers)).mean() > 0.9  # equal heights are left to its heap
    assert (found > 0).all() == bool(count)


def test_heights_and_markers_of_different_sizes_are_refused():
    with unchecked_types(), refused("watershed: expected markers"):
        photo_regions.flooded(np.zeros((3, 4), np.int32), np.zeros((4, 3), np.int32))


@few
@given(SEEDS, st.integers(2, 50), st.integers(2, 50), st.sampled_from([50, 800, 4000, 20000]), st.integers(1, 30))
def test_small_regions_are_those_of_scikit_image(seed, height, width, scale, least):
    """Where no two neighbours differ equally; its order of equal ones depends on the processor."""
    lab = colors(seed, height, width, 1600)
    costs = twin._neighbours(lab)[0]
    if len(np.unique(costs)) == len(costs):
        expected = felzenszwalb(lab / LAB_STEPS, scale=scale, sigma=twin.SIGMA, min_size=least)
        assert_array_equal(photo_regions.small_regions(lab, scale / 255, least), expected)


@pytest.mark.slow
def test_colours_near_each_other_are_sorted_to_the_last_bit():
    """Most costs of a slow ramp are alike in the bits by which they are sorted first."""
    ramp = (np.arange(400)[:, None, None] // 7 + np.arange(20)[None, :, None] // 3 + np.arange(3)).astype(np.int32)
    assert_array_equal(photo_regions.small_regions(ramp, 0.4, 5), twin.small_regions(ramp, 0.4, 5))


@pytest.mark.parametrize("shape", [(0, 5, 3), (5, 0, 3), (4, 4, 2), (2**16, 1, 3)])
def test_photos_of_other_shapes_are_refused(shape):
    with unchecked_types(), refused("expected"):
        photo_regions.small_regions(np.zeros(shape, np.int32), 1.0, 1)
    with unchecked_types(), refused("expected"):
        photo_regions.lab_colors(np.zeros(shape, np.uint8))
    with unchecked_types(), refused("expected"):
        photo_regions.look(np.zeros(shape, np.uint8), LAYERS)


# The network


@every_isa
@pytest.mark.parametrize("size", [(33, 40), (1, 1), (1, 70), (96, 161)])
def test_what_the_network_sees_is_the_twins(isa, size):
    """Numbers that lie in the middle between two steps may go to either."""
    image = photo(1, *size)
    found, expected = photo_regions.look(image, LAYERS, isa=isa), photo_network.look(image, LAYERS)
    for seen, wanted in ((found.borders, expected.borders), (found.traits, expected.traits)):
        assert np.abs(seen - wanted).max() <= 1
        assert (seen != wanted).mean() < 0.001
    again = photo_regions.look(image, LAYERS, threads=3, isa=isa)
    assert_array_equal(found.borders, again.borders)
    assert_array_equal(found.traits, again.traits)


@every_isa
def test_networks_of_other_sizes_are_the_twins(isa):
    """Two levels, whose channels fill no block."""
    rng = default_rng(0)
    sizes = [(108, 5), (45, 6), (54, 7), (63, 9), (81, 11), (9 * 18, 3), (27, 2), (2, 4 * (1 + TRAITS))]
    shapes = [shape for inputs, outputs in sizes for shape in ((inputs, outputs), (outputs,))]
    layers = tuple((rng.standard_normal(shape) * 0.3).astype(np.float32) for shape in shapes)
    image = photo(2, 21, 50)
    found, expected = photo_regions.look(image, layers, isa=isa), photo_network.look(image, layers)
    assert np.abs(found.traits - expected.traits).max() <= 1
    assert np.abs(found.borders - expected.borders).max() <= 1
    assert found.traits.std() > 1


def test_what_is_beyond_all_bounds_is_cut_off():
    last = tuple(np.full_like(part, 1e6) for part in LAYERS[-2:])
    sight = photo_regions.look(photo(3, 20, 30), (*LAYERS[:-2], *last))
    assert (sight.borders == BORDER_STEPS).all()
    assert (sight.traits == MAX_TRAIT).all()


@pytest.mark.parametrize("wrong", [LAYERS[2:], LAYERS[:-2], (*LAYERS[:4], LAYERS[4][1:], *LAYERS[5:]), ()])
def test_layers_that_do_not_fit_are_refused(wrong):
    with refused("network: expected"):
        photo_regions.look(photo(0, 8, 8), wrong)


# Sums


def seen_photo(seed: int, height: int, width: int) -> tuple[np.ndarray, np.ndarray, Sight]:
    """Labels of several pieces, each in use, and colours beyond those of any photo."""
    rng = default_rng(seed)
    labels = rng.integers(0, 4, (-(-height // 3), -(-width // 3))).repeat(3, 0).repeat(3, 1)[:height, :width]
    labels = np.unique(labels, return_inverse=True)[1].reshape(height, width).astype(np.int32)
    lab = rng.integers(-3000, 3000, (height, width, 3)).astype(np.int32)
    traits = rng.integers(-MAX_TRAIT, MAX_TRAIT, (height, width, TRAITS)).astype(np.int32)
    return labels, lab, Sight(rng.integers(0, BORDER_STEPS, (height, width)).astype(np.int32), traits)


@few
@given(SEEDS, st.integers(1, 30), st.integers(1, 30))
def test_sums_are_the_twins(seed, height, width):
    given_photo = seen_photo(seed, height, width)
    found, expected = photo_regions.region_graph(*given_photo), twin.region_graph(*given_photo)
    assert found.pixels == expected.pixels
    for name in ("sums", "boxes", "pairs", "borders"):
        assert_array_equal(getattr(found, name), getattr(expected, name))


def plain_graph(labels: np.ndarray, lab: np.ndarray, sight: Sight) -> dict[tuple[int, int], list[float]]:
    """Borders pixel by pixel: length, colour steps, what the network says, steps of traits."""
    height, width = labels.shape
    found = {}
    for y, x in np.ndindex(height, width):
        for dy, dx in ((0, 1), (1, 0)):
            if y + dy >= height or x + dx >= width or labels[y, x] == labels[y + dy, x + dx]:
                continue
            pair = sorted((int(labels[y, x]), int(labels[y + dy, x + dx])))
            inner = max(y - dy, 0), max(x - dx, 0)
            outer = min(y + 2 * dy, height - 1), min(x + 2 * dx, width - 1)
            entry = found.setdefault((pair[0], pair[1]), [0.0, 0.0, 0.0, 0.0])
            entry[0] += 1
            entry[2] += sight.borders[y, x] + sight.borders[y + dy, x + dx]
            for place, values in ((1, lab), (3, sight.traits)):
                entry[place] += np.rint(np.sqrt(float(((values[inner] - values[outer]).astype(float) ** 2).sum())))
    return found


@few
@given(SEEDS, st.integers(1, 20), st.integers(1, 20))
def test_sums_are_those_of_plain_loops(seed, height, width):
    labels, lab, sight = seen_photo(seed, height, width)
    graph = twin.region_graph(labels, lab, sight)
    expected = plain_graph(labels, lab, sight)
    assert [tuple(pair) for pair in graph.pairs.tolist()] == sorted(expected)
    for pair, border in zip(graph.pairs.tolist(), graph.borders, strict=True):
        assert_array_equal(border[[LENGTH, STEP, SEEN, TRAIT_STEP]], expected[pair[0], pair[1]])
    for i, sums in enumerate(graph.sums):
        mask = labels == i
        assert sums[AREA] == mask.sum()
        assert_array_equal(sums[1:4], lab[mask].sum(0))
        assert_array_equal(sums[4:7], (lab[mask].astype(float) ** 2).sum(0))
        assert sums[AROUND] == sum(n for pair, (n, *_) in expected.items() if i in pair)
        rows, columns = np.nonzero(mask)
        box = (columns.min(), rows.min(), -columns.max() - 1, -rows.max() - 1)
        assert_array_equal(graph.boxes[i], box)
        assert sums[HISTOGRAM].sum() == 3 * mask.sum()
        assert_array_equal(sums[TRAIT], sight.traits[mask].sum(0))
        assert sums[TRAIT_SQUARE] == (sight.traits[mask].astype(float) ** 2).sum()
    assert graph.sums[:, FRAME].sum() == 2 * sum(labels.shape)


def test_labels_that_are_none_and_arrays_that_do_not_fit_are_refused():
    labels, lab, sight = seen_photo(0, 9, 12)
    for wrong in (labels - 1, labels + labels.size, labels[1:]):
        with unchecked_types(), refused("regions: expected"):
            photo_regions.region_graph(wrong, lab, sight)
