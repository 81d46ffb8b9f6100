"""Boxes on the Earth: positions and footprints of matches and objects, of scenes in one file and in tiles."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cities import write_city
from command_line import answer_of
from drsplat.cli import main
from drsplat.errors import FormatError
from drsplat.formats.georeference import NAME, Georeference, write_georeference
from drsplat.query import Scene, open_scene
from drsplat.query.documents import earth_document
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


@pytest.mark.parametrize("seed", range(5))
def test_a_footprint_goes_anticlockwise_and_holds_every_corner(seed):
    """RFC 7946: of a box that lies in no way upright, six corners are seen from above, and all to their left."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    center, extent = np.array([1.0, -2, 3]), np.array([3.0, 2, 1])
    signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), -1).reshape(-1, 3)
    corners = 2 * (center + signs * extent @ turn) @ TURNED.enu_from_world.T
    (ring,) = earth_document(TURNED, center, turn, extent)["footprint"]["coordinates"]
    flat = metres(ring)[:, :2]
    (east, north), away = np.diff(flat, axis=0).T, corners[:, None, :2] - flat[:-1]
    assert (len(ring), ring[0]) == (7, ring[-1])
    assert (east * away[..., 1] - north * away[..., 0] > -1e-3).all()
    assert np.abs(away).sum(-1).min(0).max() < 1e-3  # each is a corner
    assert_allclose(metres(ring)[:, 2], corners[:, 2].min(), atol=1e-3)


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
