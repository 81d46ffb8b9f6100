"""Which way is up, how long a metre is and where on the Earth: told by what photos say of themselves."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from drsplat.formats.georeference import read_georeference, write_georeference
from drsplat.photos.capture.photos import ExifFacts
from drsplat.photos.capture.world import DEFAULT_MEDIAN_DEPTH, World, with_scale, world_of
from drsplat.scene.geodesy import geodetic, local_offsets
from drsplat.scene.similarity import Similarity
from drsplat.scene.views import View
from scenes import look_at_view

ORIGIN = (11.5, 48.1, 520.0)
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
HIDDEN = Similarity(0.3, TURN, np.array([5.0, -2.0, 1.0]))  # from the true world to the one that is given
NOTHING = ExifFacts()


def cameras(eyes: Sequence[tuple[float, float, float]], target: tuple[float, float, float] = (0, 0, 1)) -> list[View]:
    views = [look_at_view(eye, target) for eye in eyes]
    return [View(f"{k}.jpg", v.K, v.cam_from_world, v.width, v.height) for k, v in enumerate(views)]


def hidden(views: Sequence[View]) -> list[View]:
    """The same cameras in a world that is turned, moved and scaled."""
    moved = []
    for view in views:
        pose = np.eye(4)
        pose[:3, :3] = view.cam_from_world[:3, :3] @ HIDDEN.rotation.T
        pose[:3, 3] = -pose[:3, :3] @ HIDDEN.positions(view.center[None])[0]
        moved.append(View(view.name, view.K, pose, view.width, view.height))
    return moved


def ring(radius: float, height: float = 1.5) -> list[View]:
    turns = 2 * np.pi * np.arange(12) / 12
    return cameras([(radius * np.cos(t), radius * np.sin(t), height) for t in turns])


def world(views: Sequence[View], facts: dict[str, ExifFacts] | None = None, depth: float = 1.0) -> World:
    return world_of(hidden(views), facts or {view.name: NOTHING for view in views}, depth)


def total(found: World) -> Similarity:
    """From the true world to the one that was found."""
    one, other = HIDDEN, found.similarity
    return Similarity(one.scale * other.scale, other.rotation @ one.rotation, other.positions(one.translation[None])[0])


def tilt(found: World) -> float:
    return float(np.degrees(np.arccos(np.clip(total(found).rotation[2, 2], -1, 1))))


def with_gps(views: Sequence[View], noise: float, seed: int = 0, wrong: int = 0) -> dict[str, ExifFacts]:
    rng = default_rng(seed)
    offsets = np.array([view.center for view in views]) + rng.normal(0, noise, (len(views), 3))
    offsets[:wrong] += 300
    places = geodetic(ORIGIN, offsets)
    return {view.name: ExifFacts(position=tuple(place)) for view, place in zip(views, places.tolist(), strict=True)}


def test_up_is_square_to_the_horizons_and_units_have_no_name():
    found = world(ring(3.0), depth=0.9)
    assert (found.unit, found.up_from, found.scale_from, found.georeference) == ("units", "horizons", "", None)
    assert tilt(found) < 1e-4
    assert found.similarity.scale == pytest.approx(DEFAULT_MEDIAN_DEPTH / 0.9)


def test_gravity_counts_more_than_horizons():
    views = [
        View(v.name, v.K, roll(20.0) @ v.cam_from_world, v.width, v.height) for v in ring(3.0)
    ]  # nobody holds these level
    down = {v.name: ExifFacts(down=tuple((v.cam_from_world[:3, :3] @ [0, 0, -1]).tolist())) for v in views}
    found = world(views, down)
    assert found.up_from == "gravity"
    assert tilt(found) < 1e-4
    disagreeing = {name: ExifFacts(down=tuple(np.roll((0.0, 0.0, 1.0), k))) for k, name in enumerate(down)}
    assert world(views, disagreeing).up_from == "horizons"


def roll(degrees: float) -> np.ndarray:
    pose, angle = np.eye(4), np.radians(degrees)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return pose


def test_cameras_that_look_down_do_not_tell_what_is_up():
    turns = 2 * np.pi * np.arange(8) / 8
    views = cameras([(0.0, 0.0, 5.0)] * 8, (0.0, 0.0, 0.0))
    poses = [roll(np.degrees(t)) @ v.cam_from_world for v, t in zip(views, turns, strict=True)]
    views = [View(v.name, v.K, pose, v.width, v.height) for v, pose in zip(views, poses, strict=True)]
    assert world(views).up_from == ""


def test_gps_gives_metres_up_and_a_place_on_the_earth():
    views = ring(40.0)
    found = world(views, with_gps(views, 0.3, wrong=2))
    assert (found.unit, found.up_from, found.scale_from) == ("m", "GPS", "GPS")
    assert total(found).scale == pytest.approx(1, abs=0.02)
    assert tilt(found) < 1
    assert found.residual_m is not None
    assert found.residual_m < 1
    centers = total(found).positions(np.array([view.center for view in views]))
    true = np.array([view.center for view in views])
    placed = local_offsets(ORIGIN, found.georeference.positions(centers))
    assert np.linalg.norm(placed - true, axis=1).max() < 1


def test_gps_that_is_coarser_than_the_scene_is_not_used():
    views = ring(2.0)
    found = world(views, with_gps(views, 4.0))
    assert (found.unit, found.scale_from, found.georeference) == ("units", "", None)


def test_a_straight_walk_takes_its_length_from_gps_and_its_up_from_the_horizons():
    turns = np.linspace(-0.6, 0.6, 12)
    views = cameras([(6.0 * k, 0.02 * np.sin(k), 1.5) for k in range(12)])
    views = [View(v.name, v.K, look(v.center, t), v.width, v.height) for v, t in zip(views, turns, strict=True)]
    found = world(views, with_gps(views, 0.5))
    assert (found.unit, found.up_from, found.scale_from) == ("m", "horizons", "GPS")
    assert total(found).scale == pytest.approx(1, abs=0.02)
    assert tilt(found) < 1


def look(eye: np.ndarray, turn: float) -> np.ndarray:
    target = eye + np.array([np.sin(turn), np.cos(turn), 0.1 * turn])
    return look_at_view(tuple(eye), tuple(target)).cam_from_world


def test_a_known_scale_makes_metres():
    found = world(ring(3.0), depth=0.9)
    scaled = with_scale(found, 0.5, "scale")
    assert (scaled.unit, scaled.scale_from) == ("m", "scale")
    points = default_rng(1).normal(size=(5, 3))
    assert_allclose(scaled.similarity.positions(points), 0.5 * found.similarity.positions(points))


def test_georeferences_are_read_back(tmp_path):
    found = world(ring(40.0), with_gps(ring(40.0), 0.1)).georeference
    write_georeference(tmp_path, found)
    again = read_georeference(tmp_path)
    assert (again.longitude, again.latitude, again.height) == (found.longitude, found.latitude, found.height)
