"""Annotations: kept beside the scene as GeoJSON has features."""

import json

import numpy as np
import pytest

from drsplat.formats.annotations import AnnotationFile
from drsplat.scene.labelled import Annotation
from refusing import malformed, refused


@pytest.fixture
def file(tmp_path) -> AnnotationFile:
    return AnnotationFile.beside(tmp_path / "scene.ply")


def test_what_is_written_is_read(file):
    assert file.path.name == "scene.annotations.json"
    assert file.read() == ()
    axes = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    file.add([Annotation.at(" größe 🥤 ", (1, 2, 3))])
    file.add([Annotation.box("a box", np.ones(3), axes, np.array([1.0, 2, 3]))])
    point, box = file.read()
    assert (point.text, point.center.tolist(), point.outline) == ("größe 🥤", [1, 2, 3], None)
    np.testing.assert_array_equal(box.outline.axes, axes)
    np.testing.assert_array_equal(box.outline.extent, [1, 2, 3])


def test_other_programs_read_points(file):
    file.add([Annotation.box("a box", np.array([1.0, 2, 3]), np.eye(3), np.ones(3))])
    document = json.loads(file.path.read_text())
    assert document["type"] == "FeatureCollection"
    (feature,) = document["features"]
    assert feature["type"] == "Feature"
    assert feature["geometry"] == {"type": "Point", "coordinates": [1, 2, 3]}
    assert feature["properties"]["text"] == "a box"


def test_one_that_is_dropped_is_gone(file):
    file.add([Annotation.at(text, (0, 0, 0)) for text in "abc"])
    assert [one.text for one in file.drop(2)] == ["a", "c"]
    with refused("no annotation 3 of 2"):
        file.drop(3)
    assert [one.text for one in file.read()] == ["a", "c"]


def test_written_by_hand(file):
    feature = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2, 3]}, "properties": {"text": "a"}}
    file.path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    assert [one.text for one in file.read()] == ["a"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"type": "Feature"}, "type: expected 'FeatureCollection', got 'Feature'"),
        ({"version": 2}, "expected 'drsplat annotations' of version 1, got 2"),
        ({"features": {}}, "features: expected a list"),
        ({"features": [1]}, "features: 0: expected an object with geometry, properties, got 1"),
        (
            {"features": [{"geometry": {"type": "Polygon"}, "properties": {}}]},
            "geometry: type: expected 'Point', got 'Polygon'",
        ),
        (
            {"features": [{"geometry": {"type": "Point", "coordinates": [1, 2, 3]}, "properties": {"text": 1}}]},
            "expected a text, got 1",
        ),
        (
            {"features": [{"geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {"text": "a"}}]},
            "expected 3 numbers",
        ),
        (
            {"features": [{"geometry": {"type": "Point", "coordinates": [1, 2, 3]}, "properties": {"text": " "}}]},
            "1 to 200 characters",
        ),
    ],
)
def test_what_is_none_is_refused_in_words(file, changes, said):
    file.path.write_text(json.dumps({"type": "FeatureCollection", "features": []} | changes))
    with malformed(r"scene\.annotations\.json") as error:
        file.read()
    assert said in str(error.value)


def test_a_box_is_a_box():
    with refused("right angles"):
        Annotation.box("a", np.zeros(3), np.ones((3, 3)), np.ones(3))
    with refused("lengths above 0"):
        Annotation.box("a", np.zeros(3), np.eye(3), np.array([1.0, 0, 1]))
    with refused("three finite numbers"):
        Annotation.at("a", (np.nan, 0.0, 0.0))
