"""Sorting, images and blending weights by the CUDA kernels, which run on the CPU here.

Sorts and sums are compared with NumPy's, images and weights with the float64 twin, outside the band where float32 may
rightly decide otherwise, and with the native kernels.
"""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from test_kernels import assert_same_triples, masked

from cuda_on_cpu import CpuEngine, compiled
from drsplat.kernels import SplatArrays, render_channels, splat_arrays, topk_contributions, view_weights
from drsplat.kernels.cuda.drawing import sent_splats
from drsplat.kernels.cuda.tiling import (
    COUNTS_PER_BLOCK,
    KEYS_PER_BLOCK,
    Raster,
    room_for_splats,
    running_sums,
    sent_camera,
    sorted_pairs,
    tiles_of,
)
from drsplat.scene.views import View
from scenes import look_at_view, random_gaussians, random_mask_map
from twins import registering as reference

COUNTS = (0, 1, 31, KEYS_PER_BLOCK - 1, KEYS_PER_BLOCK + 1, 10_000)
SCENES = ("off-centre", "antialiased")
COUNT, WIDTH, HEIGHT = 900, 56, 40


@lru_cache
def arrays_of(scene: str) -> SplatArrays:
    return splat_arrays(replace(random_gaussians(COUNT, 3), antialiased=scene == "antialiased"))


@lru_cache
def view_of(scene: str) -> View:
    eye, principal = ((-1.0, 1.0, 0.5), (18.0, 29.0)) if scene == "off-centre" else ((0.0, -6.0, 1.0), None)
    return look_at_view(eye, width=WIDTH, height=HEIGHT, principal=principal)


@lru_cache
def twin_of(scene: str, first_hits: int | None = None) -> reference.Contributors:
    return reference.contributors(arrays_of(scene), view_of(scene), first_hits)


def segments_of(scene: str) -> np.ndarray:
    return random_mask_map(HEIGHT, WIDTH, 12, 0.1, SCENES.index(scene))


@pytest.fixture(scope="module")
def on_device(cuda_engine_on_cpu):
    """Return the function that sends a scene to the engine."""
    return lambda scene: sent_splats(cuda_engine_on_cpu, arrays_of(scene))


def assert_sorted(engine, keys: np.ndarray, key_bits: int) -> None:
    """Check keys, places and values beside them against NumPy's stable sort of the lowest bits."""
    order = np.argsort(keys & np.uint32(2**key_bits - 1), kind="stable")
    values = np.arange(len(keys), dtype=np.uint32)[::-1] * np.uint32(3)
    places = sorted_pairs(engine, keys.copy(), None, key_bits)
    pairs = sorted_pairs(engine, keys.copy(), values.copy(), key_bits)
    assert_array_equal(places.values, order)
    for found in (places, pairs):
        assert_array_equal(found.keys, keys[order])
    assert_array_equal(pairs.values, values[order])


# --- sorts and sums -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("key_bits", [1, 9, 32])
@pytest.mark.parametrize("count", COUNTS)
def test_a_sort_is_that_of_numpy(cuda_engine_on_cpu, count, key_bits):
    keys = default_rng(count).integers(0, 2**key_bits, count, np.uint32)
    assert_sorted(cuda_engine_on_cpu, keys, key_bits)


@pytest.mark.parametrize("keys", [np.arange(5000)[::-1], np.full(5000, 2**32 - 1), np.arange(5000) % 2 * (2**31)])
def test_keys_in_any_order_are_sorted(cuda_engine_on_cpu, keys):
    assert_sorted(cuda_engine_on_cpu, keys.astype(np.uint32), 32)


@given(keys=st.lists(st.integers(0, 2**32 - 1) | st.integers(0, 3), max_size=90), key_bits=st.integers(1, 32))
def test_any_keys_are_sorted_stably(cuda_engine_on_cpu, keys, key_bits):
    masked_keys = np.array(keys, np.uint32) & np.uint32(2**key_bits - 1)
    assert_sorted(cuda_engine_on_cpu, masked_keys, key_bits)


@pytest.mark.parametrize("count", [0, 1, 31, COUNTS_PER_BLOCK - 1, COUNTS_PER_BLOCK + 1, 10_000])
def test_running_sums_are_those_of_numpy(cuda_engine_on_cpu, count):
    rng = default_rng(count)
    counts, order = rng.integers(0, 50, count, np.uint32), rng.permutation(count).astype(np.uint32)
    assert_array_equal(running_sums(cuda_engine_on_cpu, counts), np.cumsum(counts))
    assert_array_equal(running_sums(cuda_engine_on_cpu, counts, order), np.cumsum(counts[order]))


def test_sums_beyond_32_bits_are_exact(cuda_engine_on_cpu):
    counts = np.full(COUNTS_PER_BLOCK + 5, 2**28, np.uint32)
    assert running_sums(cuda_engine_on_cpu, counts)[-1] == len(counts) * 2**28


# --- tiles ----------------------------------------------------------------------------------------


def test_tiles_hold_what_touches_them_front_to_back(cuda_engine_on_cpu):
    """Each Gaussian's tiles are as many as its count says; depths ascend within a tile."""
    engine, view = cuda_engine_on_cpu, view_of("off-centre")
    splats, raster = arrays_of("off-centre"), Raster(view.width, view.height)
    count, projected = len(splats.opacities), room_for_splats(engine, len(splats.opacities))
    camera = sent_camera(engine, view, splats.near)
    engine.launch(
        "project_scene", -(-count // 256), 256, *splats[:3], count, camera, raster.width, raster.height, False,
        0, raster.num_tiles // raster.columns, *projected,
    )  # fmt: skip
    tiles = tiles_of(engine, projected, raster)
    starts, ids = tiles.starts.astype(int), tiles.ids
    assert (starts[0], starts[-1]) == (0, len(ids))
    assert (np.diff(starts) >= 0).all()
    assert_array_equal(np.bincount(ids, minlength=count), projected.counts)
    depths = (view.cam_from_world[2, :3] @ splats.means + view.cam_from_world[2, 3]).astype(np.float32)
    for first, last in pairwise(starts):
        assert len(np.unique(ids[first:last])) == last - first
        assert (np.diff(depths[ids[first:last]]) >= -1e-5).all()
    seen = reference.contributors(splats, view)
    tile_of_entry = seen.pixels // view.width // 16 * raster.columns + seen.pixels % view.width // 16
    listed = np.repeat(np.arange(raster.num_tiles), np.diff(starts)) * count + ids
    assert np.isin(tile_of_entry * count + seen.ids, listed).mean() > 0.9999


# --- images ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [3, 11])
@pytest.mark.parametrize("scene", SCENES)
def test_an_image_is_that_of_the_twin(on_device, scene, channels):
    rng = default_rng(channels)
    values, background = rng.normal(size=(COUNT, channels)).astype(np.float32), rng.random(channels, np.float32)
    found = render_channels(on_device(scene), view_of(scene), values, background)
    seen = twin_of(scene)
    expected = reference.weighted_sums(seen, values, background)
    sure = ~seen.unsure
    assert sure.mean() > 0.97
    assert_allclose(found.channels[sure], expected.channels[sure], atol=2e-5)
    assert_allclose(found.alpha[sure], expected.alpha[sure], atol=5e-6)
    assert_allclose(found.depth[sure], expected.depth[sure], rtol=1e-4)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (9, 5), (17, 33)])
def test_views_that_fill_no_whole_tile(on_device, width, height):
    view = look_at_view((0, -5, 1), width=width, height=height)
    values = default_rng(0).random((COUNT, 3), np.float32)
    found, expected = (
        render_channels(splats, view, values) for splats in (on_device("off-centre"), arrays_of("off-centre"))
    )
    assert_allclose(found.channels, expected.channels, atol=2e-5)
    assert_allclose(found.alpha, expected.alpha, atol=2e-5)


@pytest.mark.parametrize("count", [0, 30])
def test_where_nothing_is_seen_there_is_background(cuda_engine_on_cpu, count):
    """An empty scene, and one behind the camera."""
    scene = random_gaussians(30, 0).subset(np.arange(count))
    away = look_at_view((0, -9, 1), (0, -20, 1), width=40, height=20)
    splats, background = sent_splats(cuda_engine_on_cpu, splat_arrays(scene)), np.float32([0.25, -1])
    found = render_channels(splats, away, np.ones((count, 2), np.float32), background)
    assert_array_equal(found.channels, np.broadcast_to(background, (20, 40, 2)))
    assert not found.alpha.any()
    assert not found.depth.any()
    assert len(view_weights(splats, away, np.zeros((20, 40), np.int32)).weights) == 0
    assert (topk_contributions(splats, away, 3).ids == -1).all()


# --- weights --------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [1, 3, 40, None])
@pytest.mark.parametrize("scene", SCENES)
def test_weights_are_those_of_the_twin(on_device, scene, k):
    mask_ids, expected = masked(twin_of(scene), segments_of(scene), k)
    assert_same_triples(view_weights(on_device(scene), view_of(scene), mask_ids, k), expected)


@pytest.mark.parametrize(("first_hits", "k"), [(1, 1), (5, 3), (20, None)])
def test_first_hits_cut_before_the_top_k(on_device, first_hits, k):
    mask_ids, expected = masked(twin_of("off-centre", first_hits), segments_of("off-centre"), k)
    found = view_weights(on_device("off-centre"), view_of("off-centre"), mask_ids, k, first_hits=first_hits)
    assert_same_triples(found, expected)


@pytest.mark.parametrize("k", [1, 3, 40])
@pytest.mark.parametrize("scene", SCENES)
def test_contributions_are_those_of_the_twin(on_device, scene, k):
    found = topk_contributions(on_device(scene), view_of(scene), k)
    assert (np.diff(found.weights, axis=2) <= 0).all()
    assert_array_equal(found.ids < 0, found.weights == 0)
    sure = ~reference.on_boundary(twin_of(scene), k)
    ids, weights = (table[sure] for table in reference.pixel_table(reference.largest(twin_of(scene), k), k))
    assert_array_equal(np.sort(found.ids[sure], axis=1), np.sort(ids, axis=1))
    assert_allclose(found.weights[sure], weights, rtol=3e-4, atol=1e-7)
    assert (found.ids[sure] != ids).mean() < 1e-3  # weights within rounding of each other


def test_more_weights_than_shared_memory_holds_are_chosen_alike(cuda_engine_on_cpu):
    """40 KiB of columns beside the kernel's own 24 KiB: in global memory where a block has only 48 KiB."""
    small = CpuEngine(compiled(), shared_bytes=48 << 10)
    view, maps = view_of("off-centre"), segments_of("off-centre")
    there, here = (sent_splats(engine, arrays_of("off-centre")) for engine in (small, cuda_engine_on_cpu))
    for draw in (
        lambda splats: topk_contributions(splats, view, 40),
        lambda splats: view_weights(splats, view, maps, 40),
    ):
        for one, other in zip(draw(there), draw(here), strict=True):
            assert_array_equal(one, other)


def one_pixel(opacities: list[float]) -> tuple[SplatArrays, View]:
    """Return Gaussians one behind the other, row by row nearer, that cover a view of one pixel."""
    count = len(opacities)
    means, covariances = np.zeros((3, count), np.float32), np.zeros((6, count), np.float32)
    means[2], covariances[[0, 3, 5]] = np.arange(count) + 2, 1e6
    view = View("v", np.array([[8.0, 0, 0.5], [0, 8.0, 0.5], [0, 0, 1]]), np.eye(4), 1, 1)
    return SplatArrays(means, covariances, np.array(opacities, np.float32)), view


@pytest.mark.slow
@pytest.mark.parametrize("seed", [None, 0])
def test_of_equal_weights_the_nearer_stay(cuda_engine_on_cpu, seed):
    """Opacities 1/20, 1/19, ... one behind the other: weights of 1/20, many equal to the bit, some a rounding away."""
    splats, view = one_pixel([1 / n for n in range(20, 1, -1)])
    count = len(splats.opacities)
    order = np.arange(count) if seed is None else default_rng(seed).permutation(count)
    there = sent_splats(cuda_engine_on_cpu, splats.subset(order))
    rows = np.argsort(order)  # of the Gaussians, front to back
    everything = topk_contributions(there, view, count)
    weights = np.zeros(count, np.float32)
    weights[everything.ids[0, 0]] = everything.weights[0, 0]
    heaviest = rows[np.argsort(-weights[rows], kind="stable")]
    assert np.sum(np.diff(weights[heaviest]) == 0) > count / 2
    for k in range(1, count + 1):
        assert_array_equal(topk_contributions(there, view, k).ids[0, 0], heaviest[:k])
        entries = view_weights(there, view, np.zeros((1, 1), np.int32), k)
        assert_array_equal(entries.gaussian_ids, np.sort(heaviest[:k]))


# --- the same bits --------------------------------------------------------------------------------


def test_the_same_scene_gives_the_same_bits(on_device):
    splats, view, values = on_device("antialiased"), view_of("antialiased"), np.ones((COUNT, 2), np.float32)
    first, second = (
        [
            *view_weights(splats, view, segments_of("antialiased"), 5),
            *topk_contributions(splats, view, 5),
            *render_channels(splats, view, values),
        ]
        for _ in range(2)
    )
    for one, other in zip(first, second, strict=True):
        assert one.dtype == other.dtype
        assert_array_equal(one, other)
