"""Boxes on the Earth: positions and footprints of matches and objects, of scenes in one file and in tiles."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cities import write_city
from command_line import answer_of
from drsplat.cli import main
from drsplat.errors import FormatError
from drsplat.formats.georeference import NAME, Georeference, write_georeference
from drsplat.query import Scene, open_scene
from drsplat.query.documents import earth_document, hull
from drsplat.scene.geodesy import local_offsets

HERE = (8.55, 47.37, 410.0)
TURNED = Georeference(*HERE, np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), 2.0)
"""A world whose y is east and whose -x is north, in units of two metres."""
UPRIGHT = np.eye(3)


def metres(places: Any) -> np.ndarray:
    """East, north and up of the georeference's origin."""
    return local_offsets(HERE, np.asarray(places, np.float64).reshape(-1, 3))


def test_a_box_of_known_size_lies_where_it_should():
    center, extent = np.array([3.0, 5.0, 1.0]), np.array([4.0, 2.0, 0.5])
    document = earth_document(TURNED, center, UPRIGHT, extent)
    position = [document["position"][name] for name in ("longitude", "latitude", "height")]
    assert_allclose(metres(position), [[10, -6, 2]], atol=1e-3)
    (ring,) = document["footprint"]["coordinates"]
    assert (document["footprint"]["type"], ring[0], len(ring)) == ("Polygon", ring[-1], 5)
    corners = metres(ring[:-1])
    assert {tuple(one) for one in corners.round(2)} == {(8, -10, 1.5), (12, -10, 1.5), (12, -2, 1.5), (8, -2, 1.5)}


def test_a_footprint_goes_anticlockwise_and_holds_every_corner():
    """RFC 7946: of a box that lies in no way upright, six corners are seen from above."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    (ring,) = earth_document(TURNED, np.zeros(3), turn, np.array([3.0, 2, 1]))["footprint"]["coordinates"]
    flat = metres(ring)[:, :2]
    area = float(np.sum(flat[:-1, 0] * flat[1:, 1] - flat[1:, 0] * flat[:-1, 1])) / 2
    assert len(ring) == 7
    assert area > 0


@given(st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=3, max_size=12, unique=True))
def test_a_hull_holds_all_points_and_turns_left(points):
    places = np.array(points, np.float64)
    corners = places[hull(places)]
    ahead = np.roll(corners, -1, axis=0) - corners
    offsets = places[:, None] - corners
    turns = ahead[:, 0] * offsets[..., 1] - ahead[:, 1] * offsets[..., 0]
    assert (turns >= 0).all()
    assert len(np.unique(corners, axis=0)) == len(corners)


def test_without_a_georeference_nothing_is_said():
    assert earth_document(None, np.zeros(3), UPRIGHT, np.ones(3)) == {}


@pytest.fixture(scope="module")
def city(tmp_path_factory) -> Path:
    made = write_city(tmp_path_factory.mktemp("city"))
    for name in ("tiled", "whole"):
        write_georeference(made / name, TURNED)
    return made


def opened(folder: Path) -> Scene:
    return open_scene(folder, views=folder / "capture", threads=1)


def test_the_command_line_tells_where_on_the_earth_matches_are(city, capsys):
    matches = []
    for name, scene in (("tiled", "city.tiles"), ("whole", "scene.ply")):
        given = ["locate", str(city / name / "city.field"), "red mug", "--scene", str(city / name / scene)]
        matches.append(answer_of(capsys, *given)["matches"])
    assert matches[0] == matches[1]
    (match,) = matches[0]
    east, north, up = metres(list(match["position"].values()))[0] / 2
    assert_allclose([-north, east, up], match["center"], atol=1e-3)
    assert main(given) == 0
    assert f"match 0 lies at {match['position']['latitude']:.7f}, " in capsys.readouterr().out


def test_objects_and_services_tell_it_too(city):
    pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
    from drsplat.fronts.serving.models import matches_of, object_list

    scene = opened(city / "tiled")
    (match,) = matches_of(scene, scene.locate("red mug"))
    listed = object_list(scene, scene.objects).objects
    assert {one.position.longitude for one in listed if one.position is not None} >= {match.position.longitude}
    assert all(one.footprint is not None and one.footprint.type == "Polygon" for one in listed)


def test_a_georeference_in_the_capture_counts_and_a_damaged_one_is_an_error(city, tmp_path):
    scene = write_city(tmp_path) / "tiled"
    assert opened(scene).georeference is None
    write_georeference(scene / "capture", TURNED)
    found = opened(scene).georeference
    assert found.longitude == HERE[0]
    (scene / "capture" / NAME).write_text("{}")
    with pytest.raises(FormatError, match="drsplat georeference"):
        _ = opened(scene).georeference
