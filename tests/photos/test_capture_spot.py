"""A camera that turns on the spot is refused, with and without a focal length in its photos; one that moves is not."""

import sqlite3
import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.spatial.transform import Rotation

from drsplat.errors import DrSplatWarning, InputError
from drsplat.photos.capture.capturing import capture
from drsplat.photos.capture.posing import PAIR_BASE, matched_pixels, reading, verified_pairs
from drsplat.photos.capture.turning import DOUBTFUL_SHARE, MIN_MATCHES, TURNING_SHARE, Matches, check_moved, turning
from photographed_room import HEIGHT, WIDTH, exif_of, jpeg, photographed, room_views
from scenes import look_at_view

NOISE = 0.3 / 800  # of the diagonal
SIZE = np.array([0.8, 0.6])  # of a photo, whose diagonal is 1
GUESS = 0.96
Camera = tuple[np.ndarray, np.ndarray]
"""Its axes by rows, and its centre."""


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    return Rotation.from_euler("yxz", [-yaw, pitch, roll], degrees=True).as_matrix()


def seen(points: np.ndarray, camera: Camera, focal: float, k1: float, rng: np.random.Generator) -> np.ndarray:
    """Places of points in a photo, through COLMAP's radial lens; NaN where they are outside."""
    rotation, center = camera
    rays = (points - center) @ rotation.T
    slopes = rays[:, :2] / rays[:, 2:]
    places = focal * slopes * (1 + k1 * (slopes**2).sum(1, keepdims=True)) + rng.normal(0, NOISE, slopes.shape)
    inside = (rays[:, 2] > 0) & (np.abs(places) < SIZE / 2).all(1) & (np.abs(slopes) < 1.3).all(1)  # no folds
    return np.where(inside[:, None], places, np.nan)


def pairs_of(
    cameras: Sequence[Camera], points: np.ndarray, focals: float | Sequence[float], k1: float = 0.0,
    guesses: Sequence[float] | None = None, wrong: float = 0.05,
) -> list[Matches]:  # fmt: skip
    """Matches of all pairs of photos that overlap, some of them wrong."""
    rng = default_rng(1)
    all_focals = np.broadcast_to(focals, len(cameras))
    guessed = np.full(len(cameras), GUESS) if guesses is None else np.asarray(guesses)
    photos = [seen(points, camera, f, k1, rng) for camera, f in zip(cameras, all_focals, strict=True)]
    pairs = []
    for i in range(len(cameras)):
        for j in range(i + 1, len(cameras)):
            places = np.stack([photos[i], photos[j]])[:, np.isfinite(photos[i] + photos[j]).all(1)]
            mixed = rng.random(places.shape[1]) < wrong
            places[1, mixed] = rng.permutation(places[1, mixed])
            if places.shape[1] >= MIN_MATCHES:
                pairs.append((places, guessed[[i, j], None, None]))
    return pairs


def scene(seed: int = 0) -> np.ndarray:
    """Points of all depths, in front of cameras near the origin that look along +z."""
    rng = default_rng(seed)
    depths = rng.uniform(2, 6, (6000, 1))
    return np.hstack([rng.uniform(-2, 2, (6000, 2)), np.ones((6000, 1))]) * depths


def wall(seed: int = 0) -> np.ndarray:
    return np.hstack([default_rng(seed).uniform(-6, 6, (20000, 2)), np.full((20000, 1), 2.0)])


TURNS = [turned(yaw, pitch) for yaw in (-16, -8, 0, 8, 16) for pitch in (-5, 5)]


def spot(place: Sequence[float] = (0, 0, 0)) -> list[Camera]:
    return [(rotation, np.array(place, float)) for rotation in TURNS]


def along(tilt: float = 0.0, near: float = 0.0) -> list[Camera]:
    """Cameras along a wall, each tilted and nearer or farther than the one before."""
    rng = default_rng(2)
    places = [(x, rng.normal(0, 0.1), rng.normal(0, near)) for x in np.linspace(-1, 1, 10)]
    return [(turned(*rng.normal(0, tilt, 3)), np.array(place)) for place in places]


@pytest.mark.parametrize("focal", [0.6, 0.75, 1.1, 1.5])
@pytest.mark.parametrize("k1", [-0.15, 0.0, 0.1])
def test_rotations_explain_a_camera_that_turns_whatever_its_lens(focal, k1):
    assert turning(pairs_of(spot(), scene(), focal, k1), False) == (1.0, True)


def test_a_long_lens_that_turns_is_not_told_from_one_that_is_shifted():
    cameras = [(turned(yaw, pitch), np.zeros(3)) for yaw in (-3, 0, 3) for pitch in (-2, 2)]
    assert turning(pairs_of(cameras, scene() * [0.2, 0.2, 1], 3.0), False) == (1.0, False)


def test_a_fisheye_that_turns_is_doubtful_at_least():
    """Pixels from the middle are focal lengths times the angle, as COLMAP's lens without distortion."""
    rng = default_rng(0)
    directions = rng.normal(size=(20000, 3))
    photos = []
    for rotation, _ in spot():
        x, y, z = (directions @ rotation.T).T
        aside = np.hypot(x, y)
        places = np.stack([x, y], 1) * (0.37 * np.arctan2(aside, z) / aside)[:, None] + rng.normal(0, NOISE, (20000, 2))
        photos.append(np.where((np.abs(places) < SIZE / 2).all(1)[:, None], places, np.nan))
    pairs = [np.stack([one, other]) for k, one in enumerate(photos) for other in photos[k + 1 :]]
    focals = np.full((2, 1, 1), 0.35)
    share, is_turn = turning([(pair[:, np.isfinite(pair).all((0, 2))], focals) for pair in pairs], False)
    assert is_turn
    assert share > DOUBTFUL_SHARE


def test_a_panorama_all_around_is_a_turn():
    points = default_rng(0).normal(size=(20000, 3)) * default_rng(1).uniform(1, 9, (20000, 1))
    cameras = [(turned(yaw, 5 * (-1) ** k), np.zeros(3)) for k, yaw in enumerate(range(0, 360, 18))]
    assert turning(pairs_of(cameras, points, 0.7), False) == (1.0, True)


def test_two_cameras_of_known_focal_lengths_turn_together():
    focals = [(0.6, 1.1)[k % 2] for k in range(len(TURNS))]
    assert turning(pairs_of(spot(), scene(), focals, guesses=focals), True) == (1.0, True)
    assert turning(pairs_of(spot(), scene(), focals), False)[0] < DOUBTFUL_SHARE


@pytest.mark.parametrize("focal", [0.5, 0.75, 1.1, 1.75])
def test_no_rotations_of_one_lens_explain_a_wall_along_which_the_camera_moves(focal):
    """Each of these pairs is explained by a homography."""
    assert turning(pairs_of(along(tilt=6, near=0.1), wall(), focal), False)[0] < 0.3


@pytest.mark.parametrize("k1", [0.0, -0.1])
def test_a_move_straight_along_a_wall_is_no_turn_but_may_look_like_one_of_a_long_lens(k1):
    share, is_turn = turning(pairs_of(along(), wall(), 0.75, k1), False)
    assert not is_turn
    assert share > TURNING_SHARE or k1
    known = pairs_of(along(), wall(), 0.75, guesses=[0.75] * 10)
    assert turning(known, True)[0] < 0.3


def test_a_camera_that_moves_in_a_scene_with_depth_is_explained_by_no_rotation():
    assert turning(pairs_of(along(tilt=6, near=0.1), scene(), 0.75), False)[0] == 0


@pytest.mark.parametrize("elsewhere", [along(tilt=3), spot((0.5, 0.1, 0))], ids=["walk", "another spot"])
def test_half_of_the_photos_may_be_from_one_spot(elsewhere):
    assert turning(pairs_of([*spot(), *elsewhere], scene(), 0.75)[::3], False)[0] < DOUBTFUL_SHARE


def test_what_stands_still_in_the_picture_says_nothing():
    """A camera that never moved, and what a robot holds before its camera while it moves."""
    held = default_rng(3).uniform(-0.3, 0.3, (2, 500, 2)) * [[[1, 0.2]]]
    held[1] = held[0] + 0.001
    focals = np.full((2, 1, 1), GUESS)
    assert turning([(held, focals)] * 10, False) == (0.0, False)
    moving = [(np.hstack([held, places]), focals) for places, _ in pairs_of(along(tilt=6), scene(), 0.75)]
    assert turning(moving, False)[0] == 0


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_pairs_say_nothing(count):
    assert turning(pairs_of(spot(), scene(), 0.75)[:count], False) == (0.0, False)


@pytest.mark.slow
def test_a_turn_is_an_error_a_doubtful_one_a_warning_and_a_walk_neither():
    still, walked = (pairs_of(cameras, scene(), 0.75) for cameras in (spot(), along(tilt=6)))
    with pytest.raises(InputError, match=r"rotations alone explain 100% of the pairs .* on the spot.* Walk round"):
        check_moved(still, False)
    with pytest.warns(DrSplatWarning, match=r"rotations alone explain 80% of the pairs .* may be wrong"):
        check_moved([*still[:24], *walked[:6]], False)
    with pytest.warns(DrSplatWarning, match="straight along something flat"):
        check_moved(pairs_of(along(), wall(), 0.75), False)
    check_moved(walked, False)


def test_pixels_of_matches_are_read_in_the_order_of_the_pair(tmp_path):
    keypoints = np.arange(36, dtype=np.float32).reshape(2, 3, 6)
    with sqlite3.connect(tmp_path / "a.db") as database:
        database.execute("CREATE TABLE images (image_id INTEGER, name TEXT)")
        database.execute("CREATE TABLE keypoints (image_id INTEGER, rows INTEGER, cols INTEGER, data BLOB)")
        database.execute("CREATE TABLE two_view_geometries (pair_id INTEGER, rows INTEGER, cols INTEGER, data BLOB)")
        database.executemany("INSERT INTO images VALUES (?, ?)", [(4, "z.jpg"), (9, "a.jpg")])
        rows = [(key, 3, 6, points.tobytes()) for key, points in zip((4, 9), keypoints, strict=True)]
        database.executemany("INSERT INTO keypoints VALUES (?, ?, ?, ?)", rows)
        matches = np.uint32([[0, 2], [1, 0]]).tobytes()
        database.execute("INSERT INTO two_view_geometries VALUES (?, 2, 2, ?)", (PAIR_BASE * 4 + 9, matches))
    database.close()
    with reading(tmp_path / "a.db") as database:
        (pair,) = verified_pairs(database)
        pixels = matched_pixels(database, pair)
    assert pair == ("z.jpg", "a.jpg")
    assert pixels.tolist() == [[[0, 1], [6, 7]], [[30, 31], [18, 19]]]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("pycolmap") is None, reason='needs pip install "drsplat[capture]"')
@pytest.mark.parametrize("with_exif", [False, True])
def test_photos_of_a_camera_that_turns_are_refused_and_those_of_one_that_walks_are_posed(with_exif, tmp_path):
    eye = np.array([2.1, 1.6, 1.5])
    angles = np.linspace(0.2, 1.4, 10)
    looks = [eye + np.array([-np.cos(a), -np.sin(a), -0.25 + 0.15 * (-1) ** k]) for k, a in enumerate(angles)]
    views = [look_at_view(eye, look, width=WIDTH, height=HEIGHT, fov_degrees=65) for look in looks]
    views = [replace(view, name=f"{k}.jpg") for k, view in enumerate(views)]
    for folder, taken in (("turned", views), ("walked", room_views(10))):
        (tmp_path / folder).mkdir()
        for view in taken:
            content = jpeg(photographed(view), exif_of(view) if with_exif else None)
            (tmp_path / folder / view.name).write_bytes(content)
    with pytest.raises(InputError, match="on the spot"):
        capture(tmp_path / "turned", tmp_path / "one", threads=2)
    assert not list((tmp_path / "one/.work").glob("radial_global*"))  # no time goes into poses
    with warnings.catch_warnings():
        warnings.simplefilter("error", DrSplatWarning)
        assert capture(tmp_path / "walked", tmp_path / "other", threads=2)["num_registered"] == 10
