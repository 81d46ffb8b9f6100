"""The native kernels against their float64 twin, on scenes where every rule is at work.

Outside the boundary band the same Gaussians must contribute to the same masks, and the weights
must agree in sum to 1e-6. Inside it, differences are counted and bounded.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.kernels import (
    Contributions,
    SplatArrays,
    Triples,
    available_isas,
    default_isa,
    heaviest_labels,
    render_channels,
    sh_colors,
    splat_arrays,
    topk_contributions,
    view_weights,
)
from drsplat.scene.views import View
from refusing import refused
from scenes import look_at_view, random_gaussians, random_mask_map
from twins import compositing
from twins import registering as reference

WIDTH, HEIGHT = 128, 96
SCENES = {
    "outside": (0, (0.0, -6.0, 1.0), {}),
    "oblique": (1, (4.0, -4.0, 3.0), {"fov_degrees": 45.0}),
    "inside": (2, (0.1, 0.2, 0.0), {"target": (1.0, 0.3, 0.1), "fov_degrees": 90.0}),
    "off-centre": (3, (-1.0, 1.0, 0.5), {"principal": (40.0, 70.0)}),
    "antialiased": (0, (0.0, -6.0, 1.0), {}),  # as "outside", where most splats are dimmed
}
KS = (1, 10, 20, 40, 45, None)
every_scene = pytest.mark.parametrize("scene", SCENES)
every_isa = pytest.mark.parametrize("isa", available_isas())


@lru_cache
def arrays_of(scene: str) -> SplatArrays:
    gaussians = random_gaussians(3000, SCENES[scene][0])
    return splat_arrays(replace(gaussians, antialiased=scene == "antialiased"))


@lru_cache
def view_of(scene: str) -> View:
    _, eye, options = SCENES[scene]
    return look_at_view(eye, width=WIDTH, height=HEIGHT, **options)


@lru_cache
def segments_of(scene: str) -> np.ndarray:
    return random_mask_map(HEIGHT, WIDTH, 40, 0.1, SCENES[scene][0])


@lru_cache
def twin_of(scene: str, first_hits: int | None = None) -> reference.Contributors:
    return reference.contributors(arrays_of(scene), view_of(scene), first_hits)


@lru_cache
def without_boundary(scene: str, k: int | None, first_hits: int | None = None) -> tuple[np.ndarray, reference.Triples]:
    """The scene's mask map less the boundary pixels, and the twin's weights on it."""
    return masked(twin_of(scene, first_hits), segments_of(scene), k)


def masked(twin: reference.Contributors, mask_ids: np.ndarray, k: int | None) -> tuple[np.ndarray, reference.Triples]:
    sure = np.where(reference.on_boundary(twin, k), np.int32(-1), mask_ids)
    return sure, reference.mask_sums(reference.largest(twin, k), sure)


def table(triples: Triples | reference.Triples) -> dict[tuple[int, int], float]:
    keys = zip(triples.gaussian_ids.tolist(), triples.mask_ids.tolist(), strict=True)
    return dict(zip(keys, triples.weights.tolist(), strict=True))


def assert_same_triples(native: Triples, twin: reference.Triples, tolerance: float = 1e-6) -> None:
    """Same keys in the same order; sum |error| / sum <= tolerance; no entry is wrong by much."""
    assert_array_equal(native.gaussian_ids, twin.gaussian_ids)
    assert_array_equal(native.mask_ids, twin.mask_ids)
    error = np.abs(native.weights - twin.weights)
    assert error.sum() <= tolerance * twin.weights.sum()
    assert_allclose(native.weights, twin.weights, rtol=1e-3, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("k", KS)
@every_isa
@every_scene
def test_weights_are_those_of_the_twin(scene, isa, k):
    mask_ids, expected = without_boundary(scene, k)
    native = view_weights(arrays_of(scene), view_of(scene), mask_ids, k, isa=isa)
    assert_same_triples(native, expected)


@pytest.mark.slow
@pytest.mark.parametrize("k", [10, 40, None])
@every_scene
def test_differences_in_the_boundary_band_are_few_and_small(scene, k):
    twin, mask_ids = twin_of(scene), segments_of(scene)
    boundary = reference.on_boundary(twin, k)
    assert boundary.mean() < 0.03
    native = table(view_weights(arrays_of(scene), view_of(scene), mask_ids, k))
    expected = table(reference.mask_sums(reference.largest(twin, k), mask_ids))
    different = native.keys() ^ expected.keys()
    # A pixel that decides otherwise swaps, drops or adds about one contributor.
    assert len(different) <= 2 * boundary.sum()
    total = sum(expected.values())
    assert sum(native.get(key, 0) + expected.get(key, 0) for key in different) < 0.01 * total
    error = sum(abs(native.get(key, 0) - expected.get(key, 0)) for key in native | expected)
    assert error < 0.01 * total


@pytest.mark.parametrize(("first_hits", "k"), [(1, 1), (5, 3), (20, None), (30, 10)])
@every_isa
def test_first_hits_cuts_before_the_top_k(first_hits, k, isa):
    scene = "off-centre"
    mask_ids, expected = without_boundary(scene, k, first_hits)
    native = view_weights(arrays_of(scene), view_of(scene), mask_ids, k, first_hits=first_hits, isa=isa)
    assert_same_triples(native, expected)


@pytest.mark.parametrize("most", [2**31 - 2, 2**31 - 1, 2**31, 10**30])
@every_isa
def test_as_many_first_hits_as_there_can_be_are_all(most, isa):
    given = arrays_of("off-centre"), view_of("off-centre"), segments_of("off-centre")
    expected = view_weights(*given, 5, isa=isa)
    assert len(expected.weights) > 100
    for found, column in zip(view_weights(*given, 5, first_hits=most, isa=isa), expected, strict=True):
        assert_array_equal(found, column)
    everything = view_weights(*given, None, isa=isa)
    assert_array_equal(view_weights(*given, most, isa=isa).weights, everything.weights)


@every_isa
def test_a_splat_of_more_than_sixteen_rows_of_tiles_is_whole(isa):
    K = np.array([[100.0, 0, 10], [0, 100, 350], [0, 0, 1]])
    view = View("tall.png", K, np.eye(4), 20, 700)
    sigma = np.float32([6, 0, 0, 6, 0, 0.1])[:, None] ** 2  # 150 pixels at a depth of 4
    arrays = SplatArrays(np.float32([[0], [0], [4]]), sigma, np.float32([0.8]))
    y, x = np.mgrid[:700, :20] + 0.5
    alpha = 0.8 * np.exp(-((x - 10) ** 2 + (y - 350) ** 2) / (2 * (150**2 + 0.3)))
    assert (alpha > 0.05).all()
    drawn = render_channels(arrays, view, np.ones((1, 1), np.float32), isa=isa).alpha
    assert_allclose(drawn, alpha, rtol=1e-5)
    found = view_weights(arrays, view, np.zeros((700, 20), np.int32), isa=isa)
    assert_allclose(found.weights, [alpha.sum()], rtol=1e-5)


@every_isa
def test_threads_change_no_bit(isa):
    scene, values = "inside", default_rng(0).normal(size=(3000, 5)).astype(np.float32)
    arrays, view, mask_ids = arrays_of(scene), view_of(scene), segments_of(scene)

    def everything(threads):
        return [
            *view_weights(arrays, view, mask_ids, 20, threads=threads, isa=isa),
            *topk_contributions(arrays, view, 7, threads=threads, isa=isa),
            *render_channels(arrays, view, values, threads=threads, isa=isa),
        ]

    alone = everything(1)
    for threads in (2, 3, 5, 0):
        for one, many in zip(alone, everything(threads), strict=True):
            assert one.dtype == many.dtype
            assert_array_equal(one, many)


@pytest.mark.skipif("v4" not in available_isas(), reason="this machine runs no AVX-512")
@every_scene
def test_instruction_sets_agree(scene):
    arguments = (arrays_of(scene), view_of(scene), segments_of(scene), 40)
    wide, narrow = (view_weights(*arguments, isa=isa) for isa in ("v4", "v3"))
    assert_array_equal(wide.gaussian_ids, narrow.gaussian_ids)
    assert_array_equal(wide.mask_ids, narrow.mask_ids)
    assert np.abs(wide.weights - narrow.weights).sum() <= 1e-6 * narrow.weights.sum()


@every_isa
@pytest.mark.parametrize(("width", "height"), [(1, 1), (17, 16), (31, 33), (129, 1), (1, 50), (8, 2)])
def test_rasters_that_fill_no_whole_tiles(width, height, isa):
    arrays, view = arrays_of("outside"), look_at_view((0, -5, 1), width=width, height=height)
    twin = reference.contributors(arrays, view)
    mask_ids, expected = masked(twin, random_mask_map(height, width, 5, 0.0), 20)
    assert len(expected.weights) > 0
    assert_same_triples(view_weights(arrays, view, mask_ids, 20, isa=isa), expected)


@pytest.mark.parametrize("seed", range(12))
def test_any_camera_sees_what_the_twin_sees(seed):
    """Grazing, near and wide cameras: the same keys; weights as well as float32 conditions them."""
    rng = default_rng(seed)
    eye = rng.uniform(-3, 3, 3)
    view = look_at_view(
        eye,
        eye + rng.normal(size=3),
        width=int(rng.integers(20, 100)),
        height=int(rng.integers(20, 100)),
        fov_degrees=float(rng.uniform(20, 120)),
        principal=tuple(rng.uniform(0, 80, 2)),
    )
    gaussians = random_gaussians(1000, seed, extent=float(rng.uniform(1, 3)))
    gaussians = replace(gaussians, antialiased=bool(seed % 2))
    arrays, topk = splat_arrays(gaussians), int(rng.integers(1, 50))
    twin = reference.contributors(arrays, view)
    mask_ids, expected = masked(twin, random_mask_map(view.height, view.width, 20), topk)
    for isa in available_isas():
        native = view_weights(arrays, view, mask_ids, topk, isa=isa)
        assert_same_triples(native, expected, tolerance=2e-5)


def test_a_map_without_masks_gives_nothing():
    empty = view_weights(arrays_of("outside"), view_of("outside"), np.full((HEIGHT, WIDTH), -1, np.int32))
    assert [len(column) for column in empty] == [0, 0, 0]
    assert [column.dtype for column in empty] == [np.uint32, np.int32, np.float32]


@pytest.mark.parametrize("n", [0, 1, 50])
def test_nothing_in_front_of_the_camera(n):
    arrays = splat_arrays(random_gaussians(n, extent=0.5))
    view = look_at_view((0, -5, 0), (0, -10, 0), width=40, height=20)
    assert len(view_weights(arrays, view, np.zeros((20, 40), np.int32)).weights) == 0
    nobody = topk_contributions(arrays, view, 3)
    assert (nobody.ids == -1).all()
    assert (nobody.weights == 0).all()
    background = np.float32([0.25, 0.5])
    image = render_channels(arrays, view, np.ones((n, 2), np.float32), background)
    assert_array_equal(image.channels, np.broadcast_to(background, (20, 40, 2)))
    assert_array_equal(image.alpha, 0)
    assert_array_equal(image.depth, 0)


@every_isa
def test_every_pixel_its_own_mask(isa):
    """256 masks in each tile, thousands in the view, and ids that leave gaps."""
    crowded = (np.arange(HEIGHT * WIDTH, dtype=np.int32) * 7 + 3).reshape(HEIGHT, WIDTH)
    mask_ids, expected = masked(twin_of("oblique"), crowded, 20)
    native = view_weights(arrays_of("oblique"), view_of("oblique"), mask_ids, 20, isa=isa)
    assert_same_triples(native, expected)


@every_isa
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("width", [64, 65])
def test_splats_that_reach_the_last_tile_of_a_row_are_in_all(isa, threads, width):
    """A tile for a mask: what a splat weighs there is the share of the light that it takes of the tile's pixels."""
    arrays = splat_arrays(random_gaussians(30, 4, extent=2.0, size=1.5))
    view = look_at_view((0.0, -6.0, 1.0), width=width, height=48)
    tiles = (np.arange(48)[:, None] // 16 * 5 + np.arange(width) // 16).astype(np.int32)
    found = view_weights(arrays, view, tiles, None, threads=threads, isa=isa)
    drawn = render_channels(arrays, view, np.eye(30, dtype=np.float32), threads=threads, isa=isa).channels
    expected = np.zeros((30, 15))
    np.add.at(expected.T, tiles.ravel(), drawn.reshape(-1, 30))
    weights = np.zeros((30, 15))
    weights[found.gaussian_ids, found.mask_ids] = found.weights
    assert (weights > 0).mean() > 0.5
    assert_allclose(weights, expected, rtol=1e-5, atol=1e-5)


def test_more_than_all_contributors_is_all():
    arguments = (arrays_of("outside"), view_of("outside"), segments_of("outside"))
    for generous, unlimited in zip(view_weights(*arguments, 1000), view_weights(*arguments, None), strict=True):
        assert_array_equal(generous, unlimited)


@every_isa
@pytest.mark.parametrize("scene", ["outside", "inside", "planes of one weight"])
def test_the_most_of_a_pixel_are_the_head_of_all(scene, isa):
    """Rays end early where no later weight can be among the k largest: that must change no bit."""
    if scene in SCENES:
        arrays, view = arrays_of(scene), view_of(scene)
    else:  # the i-th of 30 planes takes 1 / (31 - i) of what is left: nearly all weights are equal, many to the bit
        means = np.stack([np.zeros(30), np.zeros(30), np.arange(2, 32)]).astype(np.float32)
        covariances = np.tile(np.float32([[1e5], [0], [0], [1e5], [0], [1]]), 30)
        arrays = SplatArrays(means, covariances, (1 / (31 - np.arange(30))).astype(np.float32))
        view = View("v", np.array([[20.0, 0, 16], [0, 20.0, 8], [0, 0, 1]]), np.eye(4), 32, 16)
    every = topk_contributions(arrays, view, 300, isa=isa)
    assert (every.ids[..., -1] < 0).all()
    for k in (1, 3, 8, 20, 29):
        most = topk_contributions(arrays, view, k, isa=isa)
        assert_array_equal(most.ids, every.ids[..., :k])
        assert_array_equal(most.weights, every.weights[..., :k])


@lru_cache
def sure_contributions(scene: str, k: int) -> tuple[np.ndarray, reference.Contributions]:
    twin = twin_of(scene)
    sure = ~reference.on_boundary(twin, k)
    ids, weights = reference.pixel_table(reference.largest(twin, k), k)
    return sure, reference.Contributions(ids[sure].astype(np.int32), weights[sure])


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 10, 45])
@every_isa
@every_scene
def test_contributions_are_those_of_the_twin(scene, isa, k):
    native = topk_contributions(arrays_of(scene), view_of(scene), k, isa=isa)
    assert (np.diff(native.weights, axis=2) <= 0).all()
    assert_array_equal(native.ids < 0, native.weights == 0)
    sure, expected = sure_contributions(scene, k)
    ids = native.ids[sure]
    assert_array_equal(np.sort(ids, axis=1), np.sort(expected.ids, axis=1))
    assert_allclose(native.weights[sure], expected.weights, rtol=3e-4, atol=1e-7)
    # Weights within rounding of each other may change places; they must be very few.
    assert (ids != expected.ids).mean() < 1e-3


@every_isa
def test_equal_depths_go_by_content(isa):
    """By the bits of x, y, z, covariance and opacity, then by row: the last two rows are one Gaussian twice."""
    means = np.float32([[0, 0, 4], [1e-3, 0, 2], [0, 1e-3, 2], [0, 0, 2], [0, 0, 2], [0, 0, 2]])
    covariances = np.tile(np.float32([1e3, 0, 0, 1e3, 0, 1e3]), (6, 1))
    covariances[3, 5] = 2e3
    arrays = SplatArrays(means.T.copy(), covariances.T.copy(), np.full(6, 0.5, np.float32))
    intrinsics = np.array([[8.0, 0, 0.5], [0, 8.0, 0.5], [0, 0, 1]])
    view = View("v", intrinsics, np.eye(4), 1, 1)
    nearest = topk_contributions(arrays, view, 6, isa=isa)
    assert_array_equal(nearest.ids[0, 0], [4, 5, 3, 2, 1, 0])
    assert_array_equal(reference.contributors(arrays, view).ids, [4, 5, 3, 2, 1, 0])
    assert_allclose(nearest.weights[0, 0], 0.5 ** np.arange(1, 7), rtol=1e-5)


@every_isa
@pytest.mark.parametrize("threads", [1, 3])
def test_the_order_of_rows_changes_no_bit(isa, threads):
    """Half of the Gaussians lie on a few planes that face the camera, and so share their depths."""
    gaussians, rng = random_gaussians(3000, 7), default_rng(0)
    means = gaussians.means.copy()
    means[::2, 2] = np.round(means[::2, 2])
    gaussians = replace(gaussians, means=means)
    pose = np.eye(4)
    pose[2, 3] = 6
    view = View("v", np.array([[90.0, 0, 64], [0, 90, 48], [0, 0, 1]]), pose, WIDTH, HEIGHT)
    order = rng.permutation(3000)
    maps = segments_of("outside")
    given, turned = (
        view_weights(splat_arrays(rows), view, maps, 20, threads=threads, isa=isa)
        for rows in (gaussians, gaussians.subset(order))
    )
    back = np.lexsort((turned.mask_ids, order[turned.gaussian_ids]))
    assert_array_equal(order[turned.gaussian_ids][back], given.gaussian_ids)
    assert_array_equal(turned.mask_ids[back], given.mask_ids)
    assert_array_equal(turned.weights[back], given.weights)


VALUES = default_rng(0).normal(size=(3000, 33)).astype(np.float32)
BACKGROUND = np.linspace(-1, 1, 33, dtype=np.float32)


@lru_cache
def twin_rendering(scene: str) -> reference.Rendering:
    return reference.weighted_sums(twin_of(scene), VALUES, BACKGROUND)


@pytest.mark.parametrize("channels", [1, 3, 4, 7, 33])
@every_isa
@every_scene
def test_renderings_are_those_of_the_twin(scene, isa, channels):
    values, background = VALUES[:, :channels], BACKGROUND[:channels]
    native = render_channels(arrays_of(scene), view_of(scene), values, background, isa=isa)
    twin, sure = twin_rendering(scene), ~twin_of(scene).unsure
    error = np.abs(native.channels - twin.channels[..., :channels])[sure]
    assert error.mean() < 1e-6
    assert error.max() < 2e-5
    assert_allclose(native.alpha[sure], twin.alpha[sure], rtol=0, atol=1e-5)
    assert_allclose(native.depth[sure], twin.depth[sure], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("degree", range(4))
@every_isa
def test_colors_are_those_of_the_twin(degree, isa):
    gaussians = random_gaussians(1003, degree, sh_degree=degree)
    center = np.array([0.25, -3.0, 1.5])
    native = sh_colors(gaussians.sh, gaussians.means, center, isa=isa)
    assert native.dtype == np.float32
    assert_allclose(native, reference.sh_colors(gaussians.sh, gaussians.means, center), atol=2e-6)


def test_wrong_arguments_say_so():
    arrays, view = arrays_of("outside"), view_of("outside")
    mask_ids = segments_of("outside")
    with refused("topk"):
        view_weights(arrays, view, mask_ids, 0)
    with refused("first_hits"):
        view_weights(arrays, view, mask_ids, first_hits=-1)
    with refused("resize"):
        view_weights(arrays, view, mask_ids[1:])
    with refused("instruction set"):
        view_weights(arrays, view, mask_ids, isa="v9")
    with refused("k: expected"):
        topk_contributions(arrays, view, 0)
    with refused("values"):
        render_channels(arrays, view, np.ones((2, 3), np.float32))


def test_the_environment_may_name_the_instruction_set(monkeypatch):
    monkeypatch.setenv("DRSPLAT_ISA", "portable")
    assert default_isa() == "portable"
    monkeypatch.setenv("DRSPLAT_ISA", "v9")
    with refused("v9"):
        sh_colors(np.zeros((1, 1, 3), np.float32), np.ones((1, 3), np.float32), np.zeros(3))
    monkeypatch.delenv("DRSPLAT_ISA")
    assert default_isa() == available_isas()[0]


@pytest.mark.parametrize("threads", [1, 3])
def test_the_label_of_a_pixel_is_that_of_the_twin(threads):
    rng = default_rng(0)
    ids = rng.integers(-1, 50, (90, 70, 8)).astype(np.int32)
    weights = (rng.integers(0, 9, ids.shape) / 16).astype(np.float32)  # whose sums are exact, and often equal
    labels = rng.integers(-1, 6, 50).astype(np.int32)
    found = heaviest_labels(Contributions(ids, weights), labels, threads=threads)
    assert_array_equal(found, compositing.heaviest_labels(ids, weights, labels))


def test_pixels_of_other_gaussians_have_no_label():
    seen = Contributions(np.full((2, 3, 8), 5, np.int32), np.ones((2, 3, 8), np.float32))
    with refused(r"ids of Gaussians with a label; got \(2, 3, 8\) of 5"):
        heaviest_labels(seen, np.zeros(5, np.int32))
