"""Points out of photos: on a room whose surfaces are known, through a lens, with wrong poses, without texture."""

import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from scipy.spatial import cKDTree

import drsplat as ds
from drsplat.scene.lens import undistort_points
from drsplat.scene.photos import load_image
from drsplat.training.settings import TrainingSettings
from drsplat.training.start_points import fill, start_points
from drsplat.training.triangulation import detecting, triangulate
from drsplat.training.triangulation.detecting import Keypoints, as_stored, detect, detect_all, located
from drsplat.training.triangulation.structure import Tracks, _nearest, fundamental_matrix, join, meet, neighbours
from refusing import refused
from scenes import look_at_view

ROOM = Path(__file__).parents[2] / "world/scenes/table_1"
LENS = (0.3, -0.05, 0.002, -0.002)


@pytest.fixture(scope="module")
def views() -> list[ds.View]:
    """Four neighbours on the orbit."""
    return ds.read_views(ROOM)[:4]


@pytest.fixture(scope="module")
def surface() -> cKDTree:
    found = ds.read_sparse_points(ROOM)
    return cKDTree(found.positions)


def median_off(surface: cKDTree, positions: np.ndarray) -> float:
    return float(np.median(surface.query(positions)[0]))


def keypoints(view: ds.View) -> Keypoints:
    return located(view, as_stored(view), detect(as_stored(view)))


def test_what_masks_leave_out_has_no_keypoints(views, tmp_path):
    mask = np.zeros((views[0].height, views[0].width), np.uint8)
    mask[:, views[0].width // 2 :] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    middle = views[0].width // 2
    whole, half = keypoints(views[0]), keypoints(replace(views[0], mask_path=tmp_path / "mask.png"))
    assert (half.pixels[:, 0] >= middle).all()
    assert_array_equal(half.pixels, whole.pixels[whole.pixels[:, 0] >= middle])


def bent(views: list[ds.View], folder: Path) -> list[ds.View]:
    """The photos as a lens would have taken them."""
    made = []
    for view in views:
        lens = replace(view, distortion=LENS)
        x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
        source = undistort_points(lens, np.stack([x, y], -1)) - 0.5
        column, row = np.clip(np.rint(source), 0, (view.width - 1, view.height - 1)).astype(int).T
        Image.fromarray(load_image(view)[row.T, column.T]).save(folder / f"{view.name}.png")
        made.append(replace(lens, image_path=folder / f"{view.name}.png"))
    return made


def ring(count: int, radius: float = 3.0, **options) -> list[ds.View]:
    turns = 2 * np.pi * np.arange(count) / count
    eyes = [(radius * np.cos(t), radius * np.sin(t), 0.5) for t in turns]
    views = [look_at_view(eye, **options) for eye in eyes]
    return [replace(view, name=f"{i:03}.png") for i, view in enumerate(views)]


# --- whole photos ---


def test_points_lie_on_the_surfaces_of_a_known_room(views, surface):
    found = triangulate(views)
    assert len(found.positions) > 40
    assert median_off(surface, found.positions) < 0.04  # metres; the given points are 0.02 apart
    assert found.agreeing > 0.35 * found.alike


def test_equal_photos_give_equal_bits_in_any_order_and_number_of_threads(views):
    found, again = triangulate(views[:2], threads=1), triangulate(views[1::-1], threads=3)
    assert_array_equal(again.positions, found.positions)
    assert_array_equal(again.colors, found.colors)
    assert again[2:] == found[2:]


def test_colors_are_of_the_photos(views):
    found = triangulate(views[:2])
    view, pixels = views[0], load_image(views[0])
    seen = (found.positions - view.center) @ view.cam_from_world[:3, :3].T @ view.K.T
    column, row = (seen[:, :2] / seen[:, 2:]).astype(int).T
    off = np.abs(pixels[row, column].astype(int) - found.colors).mean(axis=1)
    assert np.median(off) < 25
    assert np.std(found.colors, axis=0).min() > 15


@pytest.mark.slow
def test_photos_of_a_lens_are_understood_by_it(views, surface, tmp_path):
    curved = bent(views[:3], tmp_path)
    found = triangulate(curved)
    assert len(found.positions) > 8
    assert median_off(surface, found.positions) < 0.05
    tree = cKDTree(keypoints(views[0]).pixels)
    off = {}
    for lens in (LENS, None):
        seen = keypoints(replace(curved[0], distortion=lens)).pixels
        off[lens] = np.median(tree.query(seen)[0])
    assert off[LENS] < 0.6 < 1.2 < off[None]  # pixels; without the lens as far as any other keypoint


def test_a_scene_far_from_its_origin_is_the_same_scene(views):
    offset = np.array([4e5, 5e6, 100.0])
    moved = []
    for view in views[:2]:
        pose = view.cam_from_world.copy()
        pose[:3, 3] -= pose[:3, :3] @ offset
        moved.append(replace(view, cam_from_world=pose))
    here, there = triangulate(views[:2]).positions, triangulate(moved).positions
    assert len(here) == pytest.approx(len(there), abs=1)
    assert cKDTree(here).query(there - offset)[0].max() < 1e-4


# --- what training makes of it ---


def started(views: list[ds.View], **settings):
    some = TrainingSettings(**({"random_points": 2000} | settings))
    return start_points(None, views, some, default_rng(0))


@pytest.mark.slow
def test_wrong_poses_are_said_in_numbers(views):
    poses = [view.cam_from_world for view in views]
    mixed = [replace(view, cam_from_world=pose) for view, pose in zip(views, [*poses[2:], *poses[:2]], strict=True)]
    with pytest.warns(ds.DrSplatWarning) as told:
        started(mixed)
    said = " ".join(str(one.message) for one in told)
    assert "matches between photos agree with their poses" in said
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        started(views)
    assert not any("agree with" in str(one.message) for one in told)


def test_many_points_need_no_random_ones(views, monkeypatch):
    monkeypatch.setattr("drsplat.training.start_points.ENOUGH_POINTS", 30)
    start = started(views)
    assert start.random == 0
    assert start.triangulated == len(start.points.positions) > 30


def test_without_texture_random_points_stand_where_several_cameras_look(tmp_path):
    Image.new("RGB", (160, 112), (90, 90, 90)).save(tmp_path / "grey.png")
    views = [replace(view, image_path=tmp_path / "grey.png") for view in ring(12)]
    with pytest.warns(ds.DrSplatWarning, match="12 photos gave 0 of the 300 points"):
        start = started(views)
    positions = start.points.positions
    assert start.plain() == {"given": 0, "triangulated": 0, "random": 2000}
    centers = np.array([view.center for view in views])
    assert cKDTree(centers).query(positions)[0].min() > 0.4
    assert np.median(np.linalg.norm(positions, axis=1)) < 2


def test_cameras_that_share_no_space_start_from_some_points(tmp_path):
    Image.new("RGB", (160, 112)).save(tmp_path / "black.png")
    outward = [
        replace(look_at_view((0, 0, 0.0), (x, y, 0.0)), image_path=tmp_path / "black.png")
        for x, y in ((1.0, 0.0), (-1.0, 0.0))
    ]
    pose = outward[1].cam_from_world.copy()
    pose[:3, 3] = [0, 0, -0.5]
    views = [outward[0], replace(outward[1], name="other.png", cam_from_world=pose)]
    with pytest.warns(ds.DrSplatWarning, match="gave 0 of the"):
        assert len(started(views).points.positions) >= 4


# --- the parts ---


def test_a_point_is_on_both_epipolar_lines():
    first, second = ring(5)[:2]
    points = default_rng(0).uniform(-0.5, 0.5, (20, 3))
    pixels = []
    for view in (first, second):
        seen = (points - view.center) @ view.cam_from_world[:3, :3].T @ view.K.T
        pixels.append(seen / seen[:, 2:])
    products = np.einsum("ni,ij,nj->n", pixels[1], fundamental_matrix(first, second), pixels[0])
    assert_allclose(products, 0, atol=1e-8)


def test_rays_meet_where_the_point_is_and_outliers_leave():
    views = ring(6)
    points = default_rng(0).uniform(-0.5, 0.5, (7, 3))
    tracks, photos = np.repeat(np.arange(7), 6), np.tile(np.arange(6), 7)
    pixels = np.empty((42, 2))
    for row, (track, photo) in enumerate(zip(tracks, photos, strict=True)):
        view = views[photo]
        seen = view.K @ view.cam_from_world[:3, :3] @ (points[track] - view.center)
        pixels[row] = seen[:2] / seen[2]
    pixels[3] += (3, 2)  # more than tolerated
    met = meet(views, Tracks(tracks, photos, photos), pixels, 3)
    assert_array_equal(met.tracks, np.arange(7))
    assert_allclose(met.positions, points, atol=1e-9)
    assert_array_equal(np.flatnonzero(~met.used), [3])
    pixels[:6] = default_rng(1).uniform(0, 100, (6, 2))
    assert_array_equal(meet(views, Tracks(tracks, photos, photos), pixels, 3).tracks, range(1, 7))


def test_rays_that_are_nearly_parallel_say_nothing():
    views = [look_at_view((3, y, 0.5), (0, y, 0.5)) for y in (0.0, 0.01)]
    tracks = Tracks(np.array([0, 0]), np.array([0, 1]), np.array([0, 0]))
    center = np.array([[80.0, 56.0]] * 2)
    assert len(meet(views, tracks, center, 2).positions) == 0


def test_a_photo_with_two_keypoints_in_a_track_leaves_it():
    pairs = np.array([[0, 1], [1, 2], [0, 2]])
    found = [np.array([[0, 0]]), np.array([[0, 0]]), np.array([[1, 0]])]
    tracks = join([2, 1, 1], pairs, found)  # photo 0 shows it at both of its keypoints
    assert_array_equal(tracks.photos, [1, 2])
    assert_array_equal(tracks.keypoints, [0, 0])
    assert_array_equal(tracks.tracks, [0, 0])
    assert len(join([2, 1], np.empty((0, 2), int), []).tracks) == 0


def test_the_nearest_is_clearly_nearer_than_the_second():
    squares = np.float32([[1.0, 9, 9, 9], [9, 4, 6, 9], [0, 9, 9, 25]])
    assert_array_equal(_nearest(squares), [0, -1, 0])
    assert_array_equal(_nearest(squares.T), [2, 1, -1, -1])


def test_neighbours_are_near_and_look_the_same_way():
    pairs = neighbours(ring(60))
    steps = np.abs(np.diff(pairs, axis=1))
    steps = np.minimum(steps, 60 - steps)
    assert steps.max() <= 10  # of 6 degrees
    assert len(pairs) <= 60 * 7
    assert (pairs[:, 0] < pairs[:, 1]).all()


def test_keypoints_are_in_pixels_of_the_view(views):
    small = views[0].resized(120, 90)
    assert_allclose(keypoints(small).pixels * 4, keypoints(views[0]).pixels, atol=1e-9)
    tiny = replace(views[0], image_path=None)
    with refused("no photo"):
        keypoints(tiny)


def test_several_processes_find_what_one_finds(views, monkeypatch):
    stored = [as_stored(view) for view in views[:2]]
    one = detect_all(stored, threads=2)
    monkeypatch.setattr(detecting, "MIN_PHOTOS_PER_PROCESS", 1)
    monkeypatch.setattr(detecting, "detect", lambda view: one[0])  # what this process finds itself
    for found, again in zip(one, detect_all(stored, threads=2), strict=True):
        for column, other in zip(found, again, strict=True):
            assert_array_equal(other, column)


def test_what_another_process_cannot_find_fails_in_this_one(views, monkeypatch, tmp_path):
    monkeypatch.setattr(detecting, "MIN_PHOTOS_PER_PROCESS", 1)
    gone = replace(as_stored(views[1]), image_path=tmp_path / "gone.png")
    with refused("gone"):
        detect_all([as_stored(views[0]), gone], threads=2)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert len(detect_all([as_stored(view) for view in views[:2]], threads=2)) == 2


def test_random_points_keep_away_from_known_ones():
    views, known = ring(8), default_rng(0).normal(0, 0.3, (200, 3))
    drawn = fill(views, known, 3000, default_rng(0), 3.0)
    spacing = np.median(cKDTree(known).query(known, k=2)[0][:, 1])
    assert len(drawn) > 1000
    assert cKDTree(known).query(drawn)[0].min() >= spacing
