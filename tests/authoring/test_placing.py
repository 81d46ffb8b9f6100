"""Small and far scenes: the unit of length and the place of the origin change no answer."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from test_registration import capture

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring
from drsplat import DrSplatWarning, Gaussians, View
from drsplat.field.evidence.aggregation import Sampling
from drsplat.formats.gaussian_ply import vertex_columns
from drsplat.formats.ply import write_vertices
from drsplat.fronts.viewing.naming import hit_by_ray, ray_along
from drsplat.fronts.viewing.shown import shown_of
from drsplat.kernels import splat_arrays
from drsplat.query.places import nearest_gaussian
from drsplat.scene.gaussians import PUBLISHED_NEAR, concatenated, local_origin, near_plane, size_of
from drsplat.training import TrainingSettings, train
from refusing import refused
from scenes import look_at_view, random_gaussians
from twins import registering as reference

laws = settings(max_examples=8)
FAR = np.array([500_000.0, 5_400_000.0, 100.0])


def scaled(gaussians: Gaussians, views: list[View], by: float) -> tuple[Gaussians, list[View]]:
    """The same scene in another unit of length."""
    small = replace(
        gaussians,
        means=(gaussians.means.astype(np.float64) * by).astype(np.float32),
        scales=(gaussians.scales.astype(np.float64) * by).astype(np.float32),
    )
    poses = [view.cam_from_world.copy() for view in views]
    for pose in poses:
        pose[:3, 3] *= by
    return small, [replace(view, cam_from_world=pose) for view, pose in zip(views, poses, strict=True)]


def moved(views: list[View], by: np.ndarray) -> list[View]:
    return [view.relative_to(-by) for view in views]


def weights(gaussians: Gaussians, views: list[View]) -> np.ndarray:
    features = capture()[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DrSplatWarning)
        return ds.register(gaussians, views, features, Sampling(10)).weights.toarray()


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    """Three units large: its near plane is already its own, not the published one."""
    return random_gaussians(400, seed=3, extent=0.8)


@pytest.fixture(scope="module")
def views(gaussians) -> list[View]:
    return capture()[0]


@pytest.mark.slow
@laws
@given(st.integers(1, 30))
def test_a_unit_of_a_power_of_two_changes_no_bit(gaussians, views, halvings):
    expected = weights(gaussians, views)
    assert expected.any()
    assert_array_equal(weights(*scaled(gaussians, views, 0.5**halvings)), expected)


@laws
@given(st.floats(1e-5, 1e5))
def test_any_unit_changes_nothing_but_rounding(gaussians, views, unit):
    expected = weights(gaussians, views)
    found = weights(*scaled(gaussians, views, unit))
    assert np.abs(found - expected).sum() < 1e-4 * expected.sum()


@laws
@given(st.tuples(*[st.floats(-1e7, 1e7)] * 3))
def test_a_scene_counted_from_an_origin_is_the_one_about_zero(gaussians, views, place):
    by = np.round(np.array(place))
    expected = weights(gaussians, views)
    found = weights(replace(gaussians, origin=by), moved(views, by))
    assert np.abs(found - expected).sum() < 1e-4 * expected.sum()


def test_a_far_scene_in_float32_is_registered_as_exactly_as_it_is_kept(gaussians, views):
    grid = np.float32(1 / 8)
    coarse, cameras = scaled(gaussians, views, 512)
    coarse = replace(coarse, means=np.round(coarse.means / grid) * grid)
    by = np.array([2.0**20, -(2.0**20), 0.0])
    far = replace(coarse, means=(coarse.means + by).astype(np.float32))
    assert_array_equal(far.means.astype(np.float64) - by, coarse.means)
    expected = weights(coarse, cameras)
    found = weights(far, moved(cameras, by))
    assert np.abs(found - expected).sum() < 1e-5 * expected.sum()
    with pytest.warns(DrSplatWarning, match="positions are float32"):
        ds.register(far, moved(cameras, by), capture()[1], Sampling(10))


def test_the_twin_sees_a_far_scene_as_a_near_one(gaussians, views):
    by = np.array([1e6, -2e6, 3e5])
    far = splat_arrays(replace(gaussians, origin=by))
    mine = reference.contributors(far, moved(views, by)[0])
    own = reference.contributors(splat_arrays(gaussians), views[0])
    assert_array_equal(mine.ids, own.ids)
    assert_allclose(mine.weights, own.weights, rtol=1e-6)


def test_pictures_of_a_far_scene_are_those_of_a_near_one(gaussians, views):
    far, cameras = replace(gaussians, origin=FAR), moved(views, FAR)
    expected = ds.render(gaussians, views[1])
    found = ds.render(far, cameras[1], select=np.arange(len(far)))
    assert_allclose(found.rgb, expected.rgb, atol=1e-5)
    assert_allclose(found.depth, expected.depth, rtol=1e-5)


def test_ordinary_scenes_have_the_published_near_plane_and_no_origin():
    room = random_gaussians(400, seed=1)
    assert room.near == PUBLISHED_NEAR == 0.2
    assert room.localized() is room
    assert not local_origin(room.means + np.float32(200)).any()
    assert splat_arrays(room).near == 0.2


def test_the_near_plane_is_a_share_of_small_scenes_and_never_more_than_published():
    room = random_gaussians(4000, seed=1)
    for scale in (1e-6, 1e-3, 0.1, 1.0, 1e6):
        small = room.means * np.float32(scale)
        size = np.linalg.norm(np.subtract(*np.quantile(small, (0.95, 0.05), axis=0)))
        assert near_plane(small, room.opacities) == pytest.approx(min(0.2, 0.05 * size), rel=0.05)
    assert near_plane(room.means[:5] * np.float32(1e-3)) == 0.2
    assert near_plane(np.zeros((100, 3), np.float32)) == 0.2


def test_a_near_plane_can_be_given_and_is_recorded(gaussians, views, tmp_path):
    features = capture()[1]
    own = ds.register(gaussians, views, features, Sampling(10), parts=tmp_path)
    assert own.sampling == Sampling(10, near=gaussians.near)
    far = ds.register(gaussians, views, features, Sampling(10, near=6.0), parts=tmp_path)
    assert far.sampling == Sampling(10, near=6.0)
    assert 0 < far.weights.sum() < 0.9 * own.weights.sum()
    fresh = ds.register(gaussians, views, features, Sampling(10, near=6.0))
    assert_array_equal(far.weights.toarray(), fresh.weights.toarray())
    field = far.to_field(ds.PQ(4))
    field.save(tmp_path / "a.field")
    assert ds.load_field(tmp_path / "a.field").aggregator.sampling == far.sampling
    with refused("in front of the camera"):
        splat_arrays(gaussians, near=-1.0)


def double_ply(path: Path, gaussians: Gaussians, by: np.ndarray) -> None:
    positions = gaussians.means.astype(np.float64) + by
    columns = vertex_columns(gaussians)
    write_vertices(path, columns | dict(zip("xyz", positions.T, strict=True)))


def test_double_positions_far_away_are_read_and_written_without_loss(gaussians, tmp_path):
    double_ply(tmp_path / "utm.ply", gaussians, FAR)
    read = ds.read_gaussians(tmp_path / "utm.ply")
    assert_allclose(read.positions, gaussians.means + FAR, atol=1e-6)
    assert_allclose(read.origin, FAR, atol=size_of(gaussians.means))
    ds.write_gaussians(tmp_path / "again.ply", read)
    again = ds.read_gaussians(tmp_path / "again.ply")
    assert_array_equal(again.positions, read.positions)
    assert again.fingerprint == read.fingerprint == read.subset(np.arange(len(read))).fingerprint


def test_blocks_far_from_each_other_are_kept_exactly_on_every_axis(gaussians):
    """Along x and z the scene is no further from zero than a few times its size, yet float32 would round it."""
    steps = np.array([[0, 0, 0], [3000, 2000, 0]]) + FAR
    city = concatenated([replace(gaussians, origin=step) for step in steps])
    expected = np.concatenate([gaussians.means.astype(np.float64) + step for step in steps])
    assert_allclose(city.positions, expected, atol=3000 * 2.0**-24, rtol=0)


def test_float32_positions_are_the_same_bits_whatever_they_are_counted_from(gaussians, tmp_path):
    """One Gaussian at zero has more digits than it could have when counted from where the others are."""
    means = (gaussians.means + np.float32(300 * size_of(gaussians.means))).astype(np.float32)
    plain = replace(gaussians, means=means)
    assert plain.localized().origin.all()
    assert plain.localized().fingerprint == plain.fingerprint
    means = means.copy()
    means[7, :2] = 1e-3, 0
    stray = replace(gaussians, means=means)
    assert (stray.localized().origin != 0).tolist() == [False, True, True]
    assert stray.localized().fingerprint == stray.fingerprint
    ds.write_gaussians(tmp_path / "again.ply", plain.localized())
    assert b"property float x" in (tmp_path / "again.ply").read_bytes()[:200]


def test_the_fingerprint_does_not_depend_on_the_origin(gaussians):
    by = np.array([1024.0, -2048.0, 0.0])
    far = replace(gaussians, means=np.float32(np.round(gaussians.means * 64) / 64 + by))
    near = replace(far, means=(far.means - by).astype(np.float32), origin=by)
    assert near.fingerprint == far.fingerprint


def test_single_positions_far_away_are_warned_of_with_the_number(gaussians, tmp_path):
    far = (gaussians.means + FAR).astype(np.float32)
    ds.write_gaussians(tmp_path / "a.ply", replace(gaussians, means=far))
    with pytest.warns(DrSplatWarning, match=r"5\.4e\+06 units from zero.*to 0\.25 units.*as double"):
        read = ds.read_gaussians(tmp_path / "a.ply")
    assert read.fingerprint == replace(gaussians, means=far).fingerprint
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ds.write_gaussians(tmp_path / "b.ply", gaussians)
        ds.read_gaussians(tmp_path / "b.ply")


@pytest.mark.parametrize(("field", "value"), [("means", 3.4e38), ("scales", 1.6e38)])
def test_numbers_that_float32_only_just_holds_are_no_noise(gaussians, views, tmp_path, field, value):
    extreme = replace(gaussians, **{field: getattr(gaussians, field).copy()})
    getattr(extreme, field)[:, 0] = value
    ds.write_gaussians(tmp_path / "scene.ply", extreme)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DrSplatWarning)
        found = ds.read_gaussians(tmp_path / "scene.ply")
        assert np.isfinite(ds.render(found, views[0]).rgb).all()
        assert np.isfinite(shown_of(found, 100).covariances).all()


def test_places_are_in_the_coordinates_of_the_world(gaussians):
    far, ids = replace(gaussians, origin=FAR), np.arange(len(gaussians))
    wanted = int(gaussians.opacities.argmax())
    point = tuple((gaussians.means[wanted] + FAR).tolist())
    assert nearest_gaussian(far, ids, point) == nearest_gaussian(
        gaussians, ids, tuple(gaussians.means[wanted].tolist())
    )
    with refused(r"is at 500000, 5400000, 900:.*, at 499999\.8"):
        nearest_gaussian(far, ids, (FAR[0], FAR[1], 900.0))
    eye, ahead = np.array([0.0, -6.0, 1.0]), np.array([0.0, 1.0, -1 / 6])
    hit, known = hit_by_ray(far, ray_along(eye + FAR, ahead)), hit_by_ray(gaussians, ray_along(eye, ahead))
    assert_array_equal(hit.gaussian_ids, known.gaussian_ids)
    assert_allclose(hit.point, known.point + FAR, atol=1e-5)


def test_units_that_make_no_sense_are_warned_of(gaussians, views):
    features = capture()[1]
    for unit in (1e-5, 1e6):
        with pytest.warns(DrSplatWarning, match="units large"):
            ds.register(*scaled(gaussians, views, unit), features, Sampling(10))
    away = look_at_view((900.0, 1, 1), width=64, height=48, fov_degrees=0.4)
    named = [replace(away, name=views[0].name)]
    with pytest.warns(DrSplatWarning, match="hardly of one frame and scale"):
        ds.register(gaussians, named, features, Sampling(10))


def test_a_small_capture_on_a_map_trains_as_one_about_zero(tmp_path):
    (tmp_path / "photos").mkdir()
    views = photographed(tmp_path / "photos", known_scene(), ring())
    points = perturbed_points(known_scene())
    few = TrainingSettings(iterations=3, sh_degree=0)
    near = train(views, few, points=points, threads=1)
    far = train(moved(views, FAR), few, tmp_path / "model", points=points.moved(FAR), threads=1).gaussians
    assert_allclose(far.positions, near.gaussians.means + FAR, atol=2e-3)
    assert_allclose(far.opacities, near.gaussians.opacities, atol=1e-3)
    stored = ds.read_gaussians(tmp_path / "model")
    assert stored.fingerprint == far.fingerprint
    cameras = ds.read_views(tmp_path / "model/cameras.json", images=tmp_path / "photos")
    assert_allclose(cameras[0].center, views[0].center + FAR, atol=1e-6)
