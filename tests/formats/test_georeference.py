"""Where on the Earth things are: closed forms of WGS 84, and files that are none."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from drsplat.errors import FormatError
from drsplat.formats.georeference import NAME, read_georeference
from drsplat.scene.geodesy import EQUATOR_RADIUS_M, FLATTENING, geocentric, geodetic

HERE = {
    "format": "drsplat georeference", "version": 1, "longitude": 13.4, "latitude": 52.5, "height": 80.0, "scale": 2.0,
    "enu_from_world": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}  # fmt: skip
POLAR = EQUATOR_RADIUS_M * (1 - FLATTENING)


def test_the_ellipsoid():
    at = geocentric(np.array([[0.0, 0, 0], [90, 0, 100], [0, 90, 0], [0, -90, 10]]))
    assert_allclose(
        at, [[EQUATOR_RADIUS_M, 0, 0], [0, EQUATOR_RADIUS_M + 100, 0], [0, 0, POLAR], [0, 0, -POLAR - 10]], atol=1e-6
    )


def test_steps_from_an_origin():
    """A degree of longitude on the equator is a 360th of its length; up is up; north goes along a meridian."""
    degree = np.pi * EQUATOR_RADIUS_M / 180
    (east,), (up,) = (geodetic((10.0, 0.0, 5.0), np.array([step])) for step in ([1.0, 0, 0], [0, 0, 7.0]))
    assert_allclose(east[0] - 10, 1 / (degree * (1 + 5 / EQUATOR_RADIUS_M)), rtol=1e-6)
    assert_allclose(up, [10, 0, 12], atol=1e-8)
    (north,) = geodetic((0.0, 0.0, 0.0), np.array([[0.0, 1000, 0]]))
    curvature = EQUATOR_RADIUS_M * (1 - FLATTENING) ** 2  # of the meridian at the equator
    assert_allclose(np.radians(north[1]) * curvature, 1000, rtol=1e-5)


@given(
    st.floats(-180, 180),
    st.floats(-89.9, 89.9),
    st.floats(-500, 9000),
    st.lists(st.floats(-3e4, 3e4), min_size=3, max_size=3),
)
def test_there_and_back(longitude, latitude, height, step):
    place = geodetic((longitude, latitude, height), np.array([step]))
    distance = np.linalg.norm(geocentric(place) - geocentric(np.array([[longitude, latitude, height]])))
    assert_allclose(distance, np.linalg.norm(step), atol=1e-5)


def test_a_file_beside_the_scene(tmp_path):
    assert read_georeference(tmp_path, None) is None
    (tmp_path / NAME).write_text(json.dumps(HERE))
    found = read_georeference(None, tmp_path)
    place = found.positions(np.array([[0.0, 0, 0], [0, -1, 0], [0, 0, 50]]))
    assert_allclose(place[0], [13.4, 52.5, 80], atol=1e-8)
    assert_allclose(place[1], [13.4, 52.5, 82], atol=1e-6)  # the world's y looks down
    assert_allclose((place[2] - place[0])[:2], [0, 100 / 111_270], atol=2e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "x"}, "expected 'drsplat georeference'"),
        ({"version": 2}, "of version 1"),
        ({"longitude": 181}, "degrees of the Earth"),
        ({"latitude": "52"}, "latitude: expected a number"),
        ({"scale": 0}, "degrees of the Earth"),
        ({"height": 1e9}, "height"),
        ({"enu_from_world": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "expected a rotation"),
        ({"enu_from_world": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}, "expected a rotation"),
        ({"enu_from_world": [[1e300, 0, 0], [0, 1, 0], [0, 0, 1]]}, "expected a finite number"),
        ({"enu_from_world": [1, 2, 3]}, "enu_from_world"),
    ],
)
def test_files_that_are_none(tmp_path, change, said):
    (tmp_path / NAME).write_text(json.dumps(HERE | change))
    with pytest.raises(FormatError, match=said):
        read_georeference(tmp_path)
