"""Paths of a camera: laws of the curve, ways that a scene suggests, and files of key frames."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from drsplat.authoring.filming import paths, planning
from drsplat.authoring.filming.looking import looking_at
from drsplat.authoring.filming.paths import MAX_FRAMES, CameraPath, KeyFrame, frame_count
from drsplat.errors import InputError
from drsplat.scene.views import View
from mutations import seeded, survivors
from refusing import malformed, refused
from scenes import look_at_view, random_gaussians

UP = np.array([0.0, 0.0, 1.0])
SIZE = (64, 48)
EYES = ((3.0, 0.0, 1.0), (0.0, 3.0, 1.5), (-3.0, 0.5, 1.0), (-1.0, -3.0, 2.0), (2.0, -2.0, 1.0))


def keys(*seconds: float) -> list[KeyFrame]:
    times = seconds or (None,) * len(EYES)
    return [KeyFrame.of(look_at_view(eye), at) for eye, at in zip(EYES, times, strict=False)]


def centers(views: list[View]) -> np.ndarray:
    return np.array([view.center for view in views])


def turned(views: list[View]) -> np.ndarray:
    """Degrees from each view to the next."""
    rotations = Rotation.from_matrix(np.array([view.cam_from_world[:3, :3] for view in views]))
    return np.degrees((rotations[:-1].inv() * rotations[1:]).magnitude())


def test_a_key_frame_is_the_camera_it_was_made_of():
    view = look_at_view((1.0, 2.0, 3.0), width=64, height=48)
    again = KeyFrame.of(view).view(SIZE)
    assert_allclose(again.K, view.K, rtol=1e-6)
    assert_allclose(again.cam_from_world, view.cam_from_world, atol=1e-6)


@pytest.mark.parametrize("closed", [False, True])
def test_a_path_passes_its_key_frames(closed):
    """Even ones at even times; from there on nothing is new in a closed one."""
    given = keys()
    count = len(given)
    views = CameraPath(given, closed, even=True).views(4 * count if closed else 4 * (count - 1) + 1, SIZE)
    for number, key in enumerate(given):
        assert_allclose(views[4 * number].cam_from_world, key.view(SIZE).cam_from_world, atol=1e-6)


def test_timed_key_frames_are_passed_at_their_times():
    path = CameraPath(keys(0.0, 1.0, 3.0, 3.5, 4.0))
    views = path.views(41, SIZE)
    for number, key in zip((0, 10, 30, 35, 40), path.keys, strict=True):
        assert_allclose(views[number].center, key.eye, atol=1e-9)


def test_a_camera_has_one_speed_and_turns_without_jerks():
    straight = [KeyFrame.of(look_at_view((x, -4.0, 1.0), (x, 0.0, 1.0))) for x in (0.0, 0.1, 2.0, 2.5, 6.0)]
    steps = np.linalg.norm(np.diff(centers(CameraPath(straight).views(100, SIZE)), axis=0), axis=1)
    assert_allclose(steps, steps.mean(), rtol=0.02)
    views = CameraPath(keys()).views(400, SIZE)
    assert turned(views).max() < 4 * turned(views).mean()
    bends = np.linalg.norm(np.diff(centers(views), 2, axis=0), axis=1)
    assert bends.max() < 0.2 * np.linalg.norm(np.diff(centers(views), axis=0), axis=1).mean()


def test_a_closed_path_goes_on_where_it_began():
    views = CameraPath(keys(), closed=True).views(200, SIZE)
    steps = np.linalg.norm(np.diff(centers([*views, views[0]]), axis=0), axis=1)
    assert steps[-1] < 1.5 * np.median(steps)
    assert turned([*views, views[0]])[-1] < 3 * turned(views).mean()


def test_lenses_lie_between_those_of_the_key_frames():
    wide, narrow = (KeyFrame.of(look_at_view(eye, fov_degrees=fov)) for eye, fov in ((EYES[0], 90.0), (EYES[1], 30.0)))
    fovs = [key.fov_degrees for key in CameraPath([wide, narrow, narrow, wide]).at(np.linspace(0, 1, 50))]
    assert min(fovs) >= narrow.fov_degrees - 1e-9
    assert max(fovs) <= wide.fov_degrees + 1e-9


def test_one_place_held_is_a_still():
    views = CameraPath([keys()[0]] * 3).views(5, SIZE)
    for view in views:
        assert_allclose(view.cam_from_world, views[0].cam_from_world, atol=1e-12)


@given(st.lists(st.tuples(*[st.floats(-10, 10)] * 3), min_size=2, max_size=8), st.booleans())
def test_any_places_make_a_path_of_rigid_cameras(places, closed):
    """View checks itself that its pose is one."""
    found = [KeyFrame.of(look_at_view(place, (20.0, 0.0, 0.0))) for place in places]
    views = CameraPath(found, closed).views(20, SIZE)
    reach = np.abs(np.array(places)).max()
    assert np.abs(centers(views)).max() <= 3 * reach + 1e-6


def test_what_no_path_can_be_made_of():
    one = keys()[0]
    with refused("2 to 20,000 key frames, got 1"):
        CameraPath([one])
    with refused("each later than the last"):
        CameraPath(keys(0.0, 2.0, 1.0, 3.0, 4.0))
    with refused("closed path"):
        CameraPath(keys(0.0, 1.0, 2.0, 3.0, 4.0), closed=True)
    with refused("fov: expected 1 to 170"):
        KeyFrame(np.zeros(3), np.eye(3), 180.0)


@pytest.mark.parametrize(
    ("seconds", "fps"),
    [
        (0.0, 30.0),
        (-1.0, 30.0),
        (1.0, 0.0),
        (1.0, -5.0),
        (1.0, 1e-300),
        (1.0, 1e9),
        (1e9, 1.0),
        (np.nan, 1.0),
        (600.0, 240.0),
    ],
)
def test_no_number_of_pictures_fills_the_memory(seconds, fps):
    with pytest.raises(InputError):
        frame_count(seconds, fps)
    assert frame_count(MAX_FRAMES / 60, 60.0) == MAX_FRAMES
    assert frame_count(0.001, 1.0) == 1


@pytest.mark.parametrize("size", [(0, 10), (10, 1), (9000, 100), (8192, 8192), (10**9, 10**9)])
def test_no_size_fills_the_memory(size):
    with refused("size: expected"):
        CameraPath(keys()).views(5, size)


# --- ways ---


def ring(count: int = 12, radius: float = 3.0) -> list[View]:
    angles = np.arange(count) * 2 * np.pi / count
    return [look_at_view((radius * np.cos(a) + 1, radius * np.sin(a) + 2, 1.5), (1.0, 2.0, 0.5)) for a in angles]


def test_an_orbit_is_a_level_circle_about_what_the_photos_look_at():
    around = planning.around_scene(random_gaussians(200), ring(), UP)
    assert_allclose(around.target, (1, 2, 0.5), atol=0.02)
    views = planning.orbit(around, UP).views(120, SIZE)
    arms = centers(views) - around.target
    assert_allclose(np.linalg.norm(arms[:, :2], axis=1), 3.0, atol=0.01)
    assert_allclose(centers(views)[:, 2], 1.5, atol=0.01)
    angles = np.unwrap(np.arctan2(arms[:, 1], arms[:, 0]))
    assert_allclose(np.diff(angles), 2 * np.pi / 120, rtol=0.02)
    for view, arm in zip(views, arms, strict=True):
        assert_allclose(view.cam_from_world[2, :3], -arm / np.linalg.norm(arm), atol=0.01)
        assert abs(view.cam_from_world[0, 2]) < 1e-3  # level


def test_an_orbit_turns_back_where_no_photo_was_taken():
    """Photos from 0 to 180 degrees: the orbit goes as far as most of them, and back; with a full ring it goes round."""
    seen = [view for view in ring(24) if view.center[1] > 1.99]
    around = planning.around_scene(random_gaussians(200), seen, UP)
    for views, most in ((seen, 160.0), (ring(24), 400.0)):
        arms = centers(planning.orbit(around, UP, views).views(144, SIZE)) - around.target
        angles = np.degrees(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
        assert np.ptp(angles) < most
        assert np.ptp(angles) > most - 50
        assert_allclose(np.linalg.norm(arms[:, :2], axis=1), np.linalg.norm(arms[0, :2]), rtol=0.01)


def test_an_orbit_without_photos_is_outside_of_the_scene():
    scene = random_gaussians(500, extent=2.0)
    around = planning.around_scene(scene, (), UP)
    assert np.linalg.norm(around.eye - around.target) > 2.0
    with refused("right above or below"):
        planning.orbit(planning.Around(np.zeros(3), 5 * UP), UP)


def test_photos_that_look_outward_are_circled_about_the_middle():
    outward = [
        look_at_view((np.cos(a), np.sin(a), 0.1), (5 * np.cos(a), 5 * np.sin(a), 0.0)) for a in (0.1, 1.5, 3.0, 5)
    ]
    assert_array_equal(planning.focus_of(outward, np.full(3, 0.25)), np.full(3, 0.25))


def test_a_swing_keeps_to_its_side_and_ends_where_it_began():
    around = planning.Around(np.zeros(3), np.array([4.0, 0, 1]))
    views = planning.swinging(around, UP).views(60, SIZE)
    angles = np.degrees(np.arctan2(*centers(views).T[1::-1]))
    assert 29 < angles.max() < 31
    assert -31 < angles.min() < -29
    assert_allclose(views[0].center, around.eye, atol=1e-9)


def test_photos_are_passed_in_their_order_and_not_too_many_of_them():
    views = [look_at_view((x, -4.0, 1 + 0.1 * (x % 2)), (x, 0, 1)) for x in range(100)]
    path = planning.through_photos(views, seconds=4.0)
    assert len(path.keys) == 9
    assert (np.diff([key.eye[0] for key in path.keys]) > 0).all()
    assert len(planning.through_photos(views[:5]).keys) == 5
    with refused("two of them or more, got 1"):
        planning.through_photos(views[:1])


def test_a_plan_is_what_is_given_else_what_the_path_wishes():
    path = CameraPath(keys(), seconds=3.0, fps=10.0, size=(101, 50))
    assert planning.planned(path)[1:] == (10.0, (100, 50))
    plan = planning.planned(path, fps=5.0, seconds=2.0, size=(80, 61), sides=2)
    assert (len(plan.views), plan.views[0].width, plan.size) == (10, 40, (80, 61))
    photos = planning.planned(CameraPath(keys()), views=[look_at_view(EYES[0], width=4000, height=3001)])
    assert photos.size == (1280, 960)
    assert len(photos.views) == 8 * 30
    with refused("a multiple of 2 across"):
        planning.planned(path, size=(81, 50), sides=2)
    with refused("orbit, swing, photos or a file"):
        planning.path_named("obrit", random_gaussians(5), [])


# --- files ---


def test_our_key_frames_come_back_as_they_were(tmp_path):
    path = CameraPath(keys(0.0, 1.0, 3.0, 3.5, 4.0), seconds=4.0, fps=24.0, size=(320, 240))
    paths.write_path(tmp_path / "path.json", path)
    again = paths.read_path(tmp_path / "path.json")
    assert (again.seconds, again.fps, again.size, again.closed, again.even) == (4.0, 24.0, (320, 240), False, False)
    for one, other in zip(path.keys, again.keys, strict=True):
        assert_allclose(other.eye, one.eye, atol=1e-12)
        assert_allclose(other.rotation, one.rotation, atol=1e-7)
        assert (other.fov_degrees, other.seconds) == (one.fov_degrees, one.seconds)
    with refused("exists already"):
        paths.write_path(tmp_path / "path.json", path)


def nerfstudio_file(count: int = 5) -> dict[str, object]:
    """As its viewer exports: camera to world, +y up and looking along -z, row after row."""
    cameras = []
    for number in range(count):
        view = looking_at(np.array([3.0 - number, -4.0, 1.0]), np.zeros(3), UP, SIZE, 50.0 + number)
        pose = np.linalg.inv(view.cam_from_world) @ np.diag([1.0, -1, -1, 1])
        cameras.append({"camera_to_world": pose.ravel().tolist(), "fov": 50.0 + number, "aspect": 16 / 9})
    return {
        "default_fov": 75.0, "keyframes": [], "camera_type": "perspective", "render_height": 90, "render_width": 160,
        "fps": float(count), "seconds": 1.0, "is_cycle": False, "smoothness_value": 0.5, "camera_path": cameras,
        "crop": None,
    }  # fmt: skip


def test_a_path_of_nerfstudio_is_filmed_picture_by_picture(tmp_path):
    """Cameras of the file against those that it was made of: +y down and ahead here, the lens from top to bottom."""
    file = tmp_path / "camera_path.json"
    file.write_text(json.dumps(nerfstudio_file()))
    plan = planning.planned(paths.read_path(file))
    assert (len(plan.views), plan.fps, plan.size) == (5, 5.0, (160, 90))
    for number, view in enumerate(plan.views):
        wanted = looking_at(np.array([3.0 - number, -4.0, 1.0]), np.zeros(3), UP, (160, 90), 50.0 + number)
        assert_allclose(view.cam_from_world, wanted.cam_from_world, atol=1e-9)
        assert_allclose(view.K, wanted.K, rtol=1e-9)


def changed(**values: object) -> dict[str, object]:
    return nerfstudio_file() | values


def with_camera(**values: object) -> dict[str, object]:
    document = nerfstudio_file()
    document["camera_path"][2].update(values)
    return document


OURS = {"format": "drsplat-path", "version": 1, "key_frames": []}
KEY = {"eye": [0, 0, 0], "target": [1, 0, 0], "up": [0, 0, 1], "fov_degrees": 50}
BROKEN = {
    "no object": ([], "expected a path"),
    "neither": ({"frames": []}, "expected a path"),
    "no cameras": (changed(camera_path=[]), "list of 1 to 20,000"),
    "too many": (changed(camera_path=[0] * 20_001), "list of 1 to 20,000"),
    "no list": (changed(camera_path={"0": 1}), "list of 1 to 20,000"),
    "a camera that is none": (changed(camera_path=[1, 2]), "camera 0: expected an object"),
    "a panorama": (changed(camera_type="equirectangular"), "camera_type 'equirectangular' is not supported"),
    "no fps": (changed(fps=0), "fps: expected a number above 0"),
    "fps in words": (changed(fps="fast"), "expected a number, got 'fast'"),
    "too fast": (changed(fps=1e9), "0.01 to 240"),
    "too long": (changed(seconds=1e9), "seconds"),
    "a huge raster": (changed(render_width=10**9), "size: expected"),
    "no width": (changed(render_width=0), "size: expected"),
    "half a pixel": (changed(render_height=90.5), "whole number"),
    "a width alone": (changed(render_height=None), "expected a number"),
    "twelve numbers": (with_camera(camera_to_world=[0.0] * 12), "expected 16 numbers"),
    "not a number": (with_camera(camera_to_world=[float("nan")] * 16), "finite"),
    "scaled": (with_camera(camera_to_world=[*(2 * np.eye(4)).ravel()[:15], 1]), "expected a rotation"),
    "mirrored": (with_camera(camera_to_world=np.diag([-1.0, 1, 1, 1]).ravel().tolist()), "expected a rotation"),
    "a last row": (with_camera(camera_to_world=[*np.eye(4).ravel()[:12], 1, 0, 0, 1]), "0 0 0 1"),
    "far away": (with_camera(camera_to_world=[1, 0, 0, 1e30, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]), "beyond"),
    "no lens": (with_camera(fov=0), "fov: expected 1 to 170"),
    "a lens behind": (with_camera(fov=200), "fov: expected 1 to 170"),
    "another version": (OURS | {"version": 2, "key_frames": [KEY, KEY]}, "of version 1"),
    "one key frame": (OURS | {"key_frames": [KEY]}, "2 to 20,000"),
    "no direction": (OURS | {"key_frames": [KEY, KEY | {"target": [0, 0, 0]}]}, "key frame 1: expected an up"),
    "up ahead": (OURS | {"key_frames": [KEY, KEY | {"up": [3, 0, 0]}]}, "key frame 1: expected an up"),
    "no up": (OURS | {"key_frames": [KEY, {"eye": [0, 0, 0], "target": [1, 1, 1]}]}, "up: expected 3 numbers"),
    "times back": (OURS | {"key_frames": [KEY | {"seconds": 1}, KEY | {"seconds": 1}]}, "each later"),
    "half timed": (OURS | {"key_frames": [KEY | {"seconds": 1}, KEY]}, "of all or of none"),
    "closed in words": (OURS | {"closed": "yes", "key_frames": [KEY, KEY]}, "true or false"),
    "three sides": (OURS | {"size": [1, 2, 3], "key_frames": [KEY, KEY]}, "expected 2 numbers"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_damaged_path_says_what_is_wrong(name, tmp_path):
    document, said = BROKEN[name]
    file = tmp_path / "path.json"
    file.write_text(json.dumps(document))
    with malformed(said) as raised:
        paths.read_path(file)
    assert str(file) in str(raised.value)


def test_a_file_that_is_no_json_or_not_there(tmp_path):
    (tmp_path / "path.json").write_bytes(b"\xff\xfe{")
    with malformed("expected JSON"):
        paths.read_path(tmp_path / "path.json")
    with refused("no such file"):
        paths.read_path(tmp_path / "none.json")


@pytest.mark.parametrize("kind", ["ours", "nerfstudio"])
def test_mutants_of_a_path_are_read_or_refused(kind, tmp_path):
    path = CameraPath(keys(), seconds=4.0, fps=24.0, size=(32, 24))
    good = paths.path_json(path) if kind == "ours" else json.dumps(nerfstudio_file())
    file = tmp_path / "path.json"
    file.write_text(good)

    def read(file):
        assert all(np.isfinite(view.cam_from_world).all() for view in paths.read_path(file).views(7, SIZE))

    assert survivors(file, read, seeded(7), 300) > 5
