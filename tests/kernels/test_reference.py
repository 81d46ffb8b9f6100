"""The float64 twin against closed forms and the laws of the method."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from scipy.special import factorial, lpmv

from drsplat.kernels import SplatArrays, splat_arrays
from drsplat.scene.gaussians import PUBLISHED_NEAR, Gaussians
from drsplat.scene.views import View
from scenes import look_at_view, random_gaussians, random_mask_map
from twins import registering as reference
from twins.projection import BLUR, dimming, project

FOCAL, WIDTH, HEIGHT = 32.0, 48, 32
AXIS_PIXEL = (16, 24)  # row, column whose centre is the principal point
laws = settings(derandomize=True, max_examples=15)


def on_axis_view() -> View:
    """Identity pose; the optical axis goes through the centre of AXIS_PIXEL."""
    intrinsics = np.array([[FOCAL, 0, 24.5], [0, FOCAL, 16.5], [0, 0, 1]])
    return View("view", intrinsics, np.eye(4), WIDTH, HEIGHT)


def gaussians_of(means, opacities, scales=0.1, quats=(1, 0, 0, 0)) -> Gaussians:
    n = len(means)
    columns = (
        np.array(means).reshape(n, 3),
        np.broadcast_to(quats, (n, 4)),
        np.broadcast_to(scales, (n, 3)),
        np.array(opacities),
        np.zeros((n, 1, 3)),
    )
    return Gaussians(*(column.astype(np.float32) for column in columns))


def arrays_of(means, opacities, scales=0.1) -> SplatArrays:
    return splat_arrays(gaussians_of(means, opacities, scales))


def weight_images(arrays: SplatArrays, view: View) -> np.ndarray:
    """(N, H, W): the weight of each Gaussian in each pixel."""
    seen = reference.contributors(arrays, view)
    images = np.zeros((len(arrays.opacities), view.height * view.width))
    images[seen.ids, seen.pixels] = seen.weights
    return images.reshape(-1, view.height, view.width)


def test_one_round_gaussian_on_the_axis():
    """alpha = o exp(-r^2 / 2 s^2) with s^2 = (f sigma / z)^2 + 0.3, cut at 1/255."""
    sigma, depth, opacity = 0.25, 4.0, 0.75
    image = weight_images(arrays_of([[0, 0, depth]], [opacity], sigma), on_axis_view())[0]
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    squared = (rows - 16.5) ** 2 + (columns - 24.5) ** 2
    expected = opacity * np.exp(-0.5 * squared / ((FOCAL * sigma / depth) ** 2 + 0.3))
    expected[expected < 1 / 255] = 0
    assert_allclose(image, expected, rtol=1e-12)
    assert image[AXIS_PIXEL] == image.max() == opacity


@pytest.mark.parametrize("sigma", [1e-3, 0.02, 0.25])
def test_an_antialiased_gaussian_is_dimmed_as_it_is_widened(sigma):
    """alpha = o s^2 / (s^2 + 0.3) exp(-r^2 / 2 (s^2 + 0.3)), s = f sigma / z: as much light as o exp(-r^2 / 2 s^2)."""
    depth, opacity = 4.0, 0.75
    arrays = arrays_of([[0, 0, depth]], [opacity], sigma)._replace(antialiased=True)
    image = weight_images(arrays, on_axis_view())[0]
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    variance, squared = (FOCAL * sigma / depth) ** 2, (rows - 16.5) ** 2 + (columns - 24.5) ** 2
    expected = opacity * variance / (variance + 0.3) * np.exp(-0.5 * squared / (variance + 0.3))
    expected[expected < 1 / 255] = 0
    assert_allclose(image, expected, rtol=1e-5)  # sigma itself is kept in float32
    assert (image.max() == 0) == (sigma == 1e-3)


@laws
@given(st.integers(0, 10**6), st.floats(1.01, 100))
def test_splats_are_dimmed_by_their_widths_and_less_the_larger_they_are(seed, factor):
    """Of an ellipse of half axes a and b: a b / sqrt((a^2 + 0.3) (b^2 + 0.3)), however it lies."""
    rng = default_rng(seed)
    axes = rng.normal(size=(2, 2)) * 10 ** rng.uniform(-2, 2)

    def dimmed(axes):
        sharp = (axes @ axes.T)[[0, 0, 1], [0, 1, 1]][None]
        return float(dimming(sharp, sharp + BLUR * np.array([1, 0, 1]))[0])

    widths = np.linalg.svd(axes)[1]
    assert_allclose(dimmed(axes), np.prod(widths / np.sqrt(widths**2 + BLUR)), rtol=1e-6)
    assert dimmed(axes) < dimmed(factor * axes) < 1


def test_pixel_centres_are_at_one_half():
    view = on_axis_view()
    # The camera point that K maps to (30.5, 9.5), the centre of column 30, row 9.
    mean = 5.0 * np.linalg.inv(view.K) @ [30.5, 9.5, 1]
    image = weight_images(arrays_of([mean], [0.9]), view)[0]
    assert np.unravel_index(image.argmax(), image.shape) == (9, 30)
    assert_allclose(image[9, 29], image[9, 31], rtol=1e-4)
    assert_allclose(image[8, 30], image[10, 30], rtol=1e-4)


def test_the_world_to_camera_pose_moves_the_scene():
    view = look_at_view((3, -2, 1), (0, 0, 0), width=31, height=21)
    image = weight_images(arrays_of([[0, 0, 0]], [0.9]), view)[0]
    assert np.unravel_index(image.argmax(), image.shape) == (10, 15)
    above = weight_images(arrays_of([[0, 0, 0.5]], [0.9]), view)[0]
    assert above.argmax() // 31 < 10  # image rows run down


def test_two_gaussians_share_the_light():
    near, far = 0.5, 0.75  # given far first: depth decides, not the index
    images = weight_images(arrays_of([[0, 0, 6.0], [0, 0, 3.0]], [far, near]), on_axis_view())
    assert images[1][AXIS_PIXEL] == near
    assert_allclose(images[0][AXIS_PIXEL], far * (1 - near), rtol=1e-12)


def test_equal_depths_go_by_content():
    """The faintest first; of the two that are the same the first row."""
    images = weight_images(arrays_of([[0, 0, 3.0]] * 3, [0.5, 0.25, 0.5]), on_axis_view())
    assert_allclose(images[(slice(None), *AXIS_PIXEL)], [0.375, 0.25, 0.1875], rtol=1e-12)


def test_opaque_layers_stop_the_ray():
    """Alpha is at most 0.99; the layer that would bring transmittance under 1e-4 is left out."""
    arrays = arrays_of([[0, 0, 2.0], [0, 0, 3.0], [0, 0, 4.0], [0, 0, 5.0]], [1.0, 0.9, 1.0, 0.5])
    images = weight_images(arrays, on_axis_view())[(slice(None), *AXIS_PIXEL)]
    # Behind the second, 1e-3 is left. The third would leave 1e-5; the fourth alone would not stop.
    assert_allclose(images, [0.99, 0.01 * 0.9, 0, 0], rtol=1e-7)
    seen = reference.contributors(arrays, on_axis_view())
    assert_allclose(seen.transmittance[AXIS_PIXEL], 1e-3, rtol=1e-6)


@pytest.mark.parametrize(
    ("depth", "opacity", "visible"),
    [(0.199, 0.9, False), (0.201, 0.9, True), (-3, 0.9, False), (3, 0.0039, False), (3, 0.004, True)],
)
def test_what_is_near_or_faint_is_culled(depth, opacity, visible):
    image = weight_images(arrays_of([[0, 0, depth]], [opacity], 0.01), on_axis_view())[0]
    assert (image[AXIS_PIXEL] > 0) == visible


def strip_view(center: float) -> View:
    intrinsics = np.array([[FOCAL, 0, center], [0, FOCAL, 8], [0, 0, 1]])
    return View("strip", intrinsics, np.eye(4), 64, 16)


def test_the_three_sigma_square_of_tiles_cuts():
    """At full opacity 1/255 lies at 3.33 sigma; the tiles of the 3-sigma square may end before."""
    variance = (FOCAL * 0.25) ** 2 + 0.3
    assert np.ceil(3 * np.sqrt(variance)) == 25
    arrays = arrays_of([[0, 0, 1.0]], [1.0], 0.25)
    image = weight_images(arrays, strip_view(8.0))[0]
    assert_array_equal(image[:, 32:], 0)  # 8 - 0.5 + 25 + 15 = 47.5 is two tiles
    assert np.exp(-0.5 * (24.5**2 + 0.25) / variance) > 1 / 255
    assert weight_images(arrays, strip_view(9.0))[0][8, 32] > 1 / 255  # 48.5 is three


def test_a_square_that_ends_on_a_tile_border_is_unsure():
    arrays = arrays_of([[0, 0, 1.0]], [1.0], 0.25)
    assert reference.contributors(arrays, strip_view(8.5)).unsure[8, 32]  # 8.5 - 0.5 + 25 + 15 = 48
    for center in (8.0, 9.0):
        assert not reference.contributors(arrays, strip_view(center)).unsure[8, 32]


@pytest.mark.parametrize("sigma", [0.005, 0.04, 0.13, 0.5])
def test_tile_rectangles_of_round_gaussians(sigma):
    """Half width ceil(3 sqrt(s^2 + sqrt(0.1))): 3DGS floors the discriminant at 0.1."""
    columns = np.linspace(-40, 88, 400) + 0.0123
    means = [[(column - 24.5) / FOCAL, 0, 1.0] for column in columns]
    view = replace(on_axis_view(), width=480)  # wide enough for the Jacobian not to be clamped
    tiles = project(arrays_of(means, np.ones(400), sigma), view)
    columns = columns[tiles.ids]
    squared = (FOCAL * sigma) ** 2 + 0.3
    shear = squared + (FOCAL * sigma * (columns - 24.5) / FOCAL) ** 2  # x spread grows off axis
    mid, det = (squared + shear) / 2, squared * shear
    reach = np.ceil(3 * np.sqrt(mid + np.sqrt(np.maximum(0.1, mid**2 - det))))
    assert (reach > 0).all()
    first = [math.floor(low / 16) for low in columns - 0.5 - reach]
    end = [math.floor((high + 15) / 16) for high in columns - 0.5 + reach]
    assert_array_equal(tiles.tiles[:, 0], np.maximum(first, -1))
    assert_array_equal(tiles.tiles[:, 2], np.maximum(end, -1))
    assert (tiles.possible_tiles[:, :2] <= tiles.tiles[:, :2]).all()
    assert (tiles.tiles[:, :2] <= tiles.certain_tiles[:, :2]).all()
    assert (tiles.possible_tiles[:, 2:] >= tiles.tiles[:, 2:]).all()
    assert (tiles.tiles[:, 2:] >= tiles.certain_tiles[:, 2:]).all()


def test_the_jacobian_is_clamped_outside_the_frustum():
    """Beyond 1.3 tan(fov/2) the ellipse keeps the shape it has at the limit."""
    limit = 1.3 * 0.5 * WIDTH / FOCAL
    arrays = arrays_of([[2 * limit * 2.0, 0, 2.0]], [1.0], [0.3, 0.2, 0.4])  # twice as far out
    conic = project(arrays, on_axis_view()).conics[0]
    j_x, j_z = FOCAL / 2, -FOCAL * limit / 2
    variance = (j_x * 0.3) ** 2 + (j_z * 0.4) ** 2 + 0.3
    assert_allclose(conic, [1 / variance, 0, 1 / ((j_x * 0.2) ** 2 + 0.3)], rtol=1e-6, atol=1e-9)


def test_quaternions_are_wxyz():
    """A quarter turn about z swaps the x and y extents, about x y and z; turns go from x to y."""
    half = np.sqrt(0.5)
    for quat, axes in [((half, 0, 0, half), [1, 0, 2]), ((half, half, 0, 0), [0, 2, 1])]:
        scales = np.array([0.1, 0.2, 0.4])
        turned = gaussians_of([[0, 0, 3]], [1.0], scales, quat).covariances()
        expected = scales[axes] ** 2
        assert_allclose(turned[0, [0, 3, 5]], expected, rtol=1e-6)
        assert_allclose(turned[0, [1, 2, 4]], 0, atol=1e-8)
    eighth = (np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))
    long_in_x = gaussians_of([[0, 0, 3]], [1.0], [0.4, 0.2, 0.1], eighth).covariances()
    assert_allclose(long_in_x[0, 1], (0.4**2 - 0.2**2) / 2, rtol=1e-6)


def test_weights_and_transmittance_sum_to_one():
    arrays = splat_arrays(random_gaussians(800, 5, size=0.25))
    view = look_at_view((0, -6, 1), width=WIDTH, height=HEIGHT)
    seen = reference.contributors(arrays, view)
    total = np.bincount(seen.pixels, seen.weights, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    assert_allclose(total + seen.transmittance, 1, rtol=1e-12)
    assert (seen.transmittance >= 1e-4).all()
    assert (seen.weights >= 1e-4 / 255).all()
    assert seen.transmittance.min() < 1e-3 < seen.transmittance.max()  # the scene has both


def test_depth_is_the_weighted_mean_of_camera_z():
    arrays = arrays_of([[0, 0, 6.0], [0, 0, 3.0]], [0.75, 0.5])
    image = reference.render_channels(arrays, on_axis_view(), np.zeros((2, 1)))
    weights = np.array([0.5, 0.375])
    assert_allclose(image.alpha[AXIS_PIXEL], weights.sum(), rtol=1e-12)
    assert_allclose(image.depth[AXIS_PIXEL], weights @ [3.0, 6.0] / weights.sum(), rtol=1e-12)
    assert image.depth[0, 0] == image.alpha[0, 0] == 0


def test_topk_keeps_the_largest_weights():
    means = [[0, 0, 2.0], [0, 0, 3.0], [0, 0, 4.0], [0, 0, 5.0]]
    arrays = arrays_of(means, [0.125, 0.5, 0.25, 0.75])
    weights = np.array([0.125, 0.4375, 0.109375, 0.24609375])
    full = reference.topk_contributions(arrays, on_axis_view(), 6)
    assert_array_equal(full.ids[AXIS_PIXEL], [1, 3, 0, 2, -1, -1])
    assert_allclose(full.weights[AXIS_PIXEL], [*weights[[1, 3, 0, 2]], 0, 0], rtol=1e-12)
    two = reference.topk_contributions(arrays, on_axis_view(), 2)
    assert_array_equal(two.ids[AXIS_PIXEL], [1, 3])


def test_first_hits_cuts_before_topk():
    means = [[0, 0, 2.0], [0, 0, 3.0], [0, 0, 4.0], [0, 0, 5.0]]
    arrays = arrays_of(means, [0.125, 0.5, 0.25, 0.75])
    cut = reference.topk_contributions(arrays, on_axis_view(), 2, first_hits=3)
    assert_array_equal(cut.ids[AXIS_PIXEL], [1, 0])


def test_ties_keep_the_nearer():
    raster = np.zeros((1, 2))
    seen = reference.Contributors(
        pixels=np.array([0, 0, 0, 1, 1]),
        ids=np.array([9, 4, 7, 2, 1]),
        weights=np.array([0.25, 0.5, 0.25, 0.125, 0.125]),
        depths=np.arange(5.0),
        transmittance=raster,
        unsure=raster.astype(bool),
    )
    assert_array_equal(reference.largest(seen, 1).ids, [4, 2])
    assert_array_equal(reference.largest(seen, 2).ids, [9, 4, 2, 1])
    assert_array_equal(reference.on_boundary(seen, 1), [[False, True]])
    assert_array_equal(reference.on_boundary(seen, 2), [[True, False]])
    assert_array_equal(reference.on_boundary(seen, None), [[False, False]])
    triples = reference.mask_sums(seen, np.int32([[5, 5]]))
    assert_array_equal(triples.gaussian_ids, [1, 2, 4, 7, 9])


def test_masks_split_the_weights():
    arrays = splat_arrays(random_gaussians(800, 7, size=0.25))
    view = look_at_view((0, -6, 1), width=WIDTH, height=HEIGHT)
    mask_ids = random_mask_map(HEIGHT, WIDTH, 9, 0.3, 1)
    assert (mask_ids == -1).any()
    triples = reference.view_weights(arrays, view, mask_ids, None)
    images = weight_images(arrays, view)
    dense = np.zeros((800, 9))
    dense[triples.gaussian_ids, triples.mask_ids] = triples.weights
    for mask in range(9):
        assert_allclose(dense[:, mask], images[:, mask_ids == mask].sum(1), rtol=1e-9)
    keys = triples.gaussian_ids * 9 + triples.mask_ids
    assert (np.diff(keys) > 0).all()
    assert (triples.weights > 0).all()


@pytest.mark.parametrize(
    ("opacity", "depths", "why"),
    [
        (1 / 255 * (1 + 1e-5), [3.0], "the peak is on the 1/255 cut"),
        (0.5, [3.0, 3.0 * (1 + 1e-7)], "two depths are one in float32"),
        (0.9, [2.0, 3.0, 4.0, 5.0], "the fourth brings transmittance to 1e-4"),
    ],
)
def test_discontinuities_are_marked(opacity, depths, why):
    def unsure(opacity, depths):
        arrays = arrays_of([[0, 0, depth] for depth in depths], [opacity] * len(depths))
        return bool(reference.contributors(arrays, on_axis_view()).unsure[AXIS_PIXEL])

    assert unsure(opacity, depths), why
    assert not unsure(opacity * 1.02, [3.0 * (i + 1) for i in range(len(depths))])


def test_sh_degree_0_and_1():
    center = np.array([1.0, 2, 3])
    means = np.array([[3.0, 0, 0], [0, 2, 0], [0, 0, 5], [-1, 0, 0]]) + center
    sh = np.zeros((4, 4, 3))
    sh[:, 0] = [0.1, 0.2, -9]
    sh[:, 1:] = np.array([0.3, 0.4, 0.5])[:, None]  # of y, z, x
    flat, tilt = 0.28209479177387814, 0.4886025119029199  # 1/2 sqrt(1/pi), 1/2 sqrt(3/pi)
    slope = tilt * np.array([-0.5, -0.3, 0.4, 0.5])
    expected = np.maximum(0, 0.5 + flat * np.array([0.1, 0.2, -9]) + slope[:, None])
    assert_allclose(reference.sh_colors(sh, means, center), expected, rtol=1e-12)
    assert_allclose(
        reference.sh_colors(sh[:, :1], means, np.zeros(3))[0], [0.5 + 0.1 * flat, 0.5 + 0.2 * flat, 0], rtol=1e-12
    )


def test_sh_basis_is_that_of_associated_legendre_functions():
    """sqrt(2) Re Y_l^m for m > 0 and sqrt(2) Im Y_l^|m| for m < 0, Condon-Shortley phase kept."""
    directions = default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            order = abs(m)
            ratio = factorial(degree - order) / factorial(degree + order)
            norm = np.sqrt((2 * degree + 1) / (4 * np.pi) * ratio)
            wave = np.sin(order * azimuth) if m < 0 else np.cos(order * azimuth)
            scale = np.sqrt(2) if m else 1.0
            columns.append(scale * norm * lpmv(order, degree, directions[:, 2]) * wave)
    assert_allclose(reference.sh_basis(directions), np.stack(columns, 1), atol=1e-12)


class ExactSplats(NamedTuple):
    """Splats in float64, so that laws hold to float64 rounding."""

    means: np.ndarray
    covariances: np.ndarray
    opacities: np.ndarray
    near: float = PUBLISHED_NEAR
    origin: np.ndarray = np.zeros(3)
    antialiased: bool = False


def exact_scene(seed: int) -> ExactSplats:
    gaussians = random_gaussians(250, seed, size=0.3)
    means, opacities = gaussians.means.astype(np.float64), gaussians.opacities.astype(np.float64)
    return ExactSplats(means.T, gaussians.covariances().T, opacities)


def assert_same_weights(first: ExactSplats, first_view: View, other: ExactSplats, view: View):
    images = weight_images(first, first_view)
    assert (images > 0).any()
    assert_allclose(weight_images(other, view), images, rtol=1e-7, atol=1e-10)


VIEW = look_at_view((0, -6, 1), width=WIDTH, height=HEIGHT)
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.slow
@laws
@given(seeds)
def test_moving_scene_and_camera_together_changes_nothing(seed):
    scene, rng = exact_scene(seed), default_rng(seed)
    rotation, shift = Rotation.from_quat(rng.normal(size=4)).as_matrix(), rng.uniform(-5, 5, (3, 1))
    covariances = scene.covariances.T[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    turned = (rotation @ covariances @ rotation.T)[:, *np.triu_indices(3)].T
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3:] = rotation, shift
    view = replace(VIEW, cam_from_world=VIEW.cam_from_world @ np.linalg.inv(motion))
    moved = ExactSplats(rotation @ scene.means + shift, turned, scene.opacities)
    assert_same_weights(scene, VIEW, moved, view)


@laws
@given(seeds, st.floats(1e-6, 1e6))
def test_the_unit_of_length_changes_nothing(seed, unit):
    scene, pose = exact_scene(seed), VIEW.cam_from_world.copy()
    pose[:3, 3] *= unit
    scaled = ExactSplats(scene.means * unit, scene.covariances * unit**2, scene.opacities, scene.near * unit)
    assert_same_weights(scene, VIEW, scaled, replace(VIEW, cam_from_world=pose))


@laws
@given(seeds)
def test_the_order_of_gaussians_changes_only_ids(seed):
    scene = exact_scene(seed)
    order = default_rng(seed).permutation(len(scene.opacities))
    shuffled = ExactSplats(*(column[..., order] for column in scene[:3]))
    assert_array_equal(weight_images(shuffled, VIEW), weight_images(scene, VIEW)[order])


@laws
@given(seeds, st.integers(1, 50))
def test_topk_grows_to_the_whole(seed, k):
    scene = exact_scene(seed)
    seen = reference.contributors(scene, VIEW)
    kept, more = (reference.largest(seen, count) for count in (k, k + 1))
    size = WIDTH * HEIGHT
    sums = [np.bincount(part.pixels, part.weights, size) for part in (kept, more, seen)]
    assert (sums[0] <= sums[1]).all()
    assert (sums[1] <= sums[2] + 1e-12).all()
    assert np.bincount(kept.pixels, minlength=size).max() == min(k, np.bincount(seen.pixels).max())
    left_out = np.setdiff1d(
        seen.ids + len(scene.opacities) * seen.pixels, kept.ids + len(scene.opacities) * kept.pixels
    )
    assert len(left_out) == len(seen.ids) - len(kept.ids)
