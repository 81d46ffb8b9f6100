"""Outlines of things in photos (benchmarks/suite/outlines.py): what is known where not all things were outlined."""

import json
from pathlib import Path

import numpy as np
import pytest
from benchmarks.suite import places
from benchmarks.suite.outlines import outlined_in_part, outlines_path, read_outlines

from drsplat import View

SQUARE = [[2, 2], [5, 2], [5, 5], [2, 5]]


@pytest.fixture
def outlines(tmp_path: Path) -> Path:
    """Two photos that show a cup and a pan; the pan was outlined in the first one only."""
    path = tmp_path / "outlines.json"
    drawn = {"a.jpg": {"cup": SQUARE, "pan": [[7, 7], [9, 7], [9, 9]]}, "b.jpg": {"cup": SQUARE, "pan": []}}
    path.write_text(json.dumps(drawn), encoding="utf-8")
    return path


def test_a_thing_without_corners_was_not_outlined(outlines):
    assert {photo: sorted(things) for photo, things in read_outlines(outlines).items()} == {
        "a.jpg": ["cup", "pan"],
        "b.jpg": ["cup"],
    }
    assert outlined_in_part(outlines) == {"b.jpg"}


def test_the_rest_of_a_photo_is_known_only_where_all_things_were_outlined(outlines, monkeypatch):
    """Else a doll in a photo of which only the carrot was outlined counts as no thing."""
    camera = np.array([[10.0, 0, 5], [0, 10, 5], [0, 0, 1]])
    views = [View(name, camera, np.eye(4), 10, 10) for name in ("a.jpg", "b.jpg")]
    monkeypatch.setattr(places, "read_views", lambda folder: views)
    names, known = places._outlined(Path("capture"), outlines)
    assert names == ["cup", "pan"]
    assert set(np.unique(known["a.jpg"])) == {0, 1, 2}  # 2: neither
    assert set(np.unique(known["b.jpg"])) == {0, places.UNKNOWN}


def test_photos_of_the_captures_that_show_more_than_was_outlined():
    assert len(outlined_in_part(outlines_path("plush"))) == 4
    assert outlined_in_part(outlines_path("brighton_beach")) == {"DJI_0033.JPG"}
    assert not outlined_in_part(outlines_path("desk_penguin"))
