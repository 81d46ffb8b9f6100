"""Time in the viewer: what is shown, asked and clicked at a time."""

import numpy as np
import pytest

from drsplat.authoring.editing import Edit, Everything, Move, Remove
from drsplat.fronts.viewing.session import Session
from drsplat.fronts.viewing.stage import Stage
from drsplat.query import Scene
from moving_scenes import passing_red_scene

CAR = np.arange(100)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return passing_red_scene()


def test_fewer_than_all_move_as_well(scene):
    session = Session(scene, budget=120)
    session.time = 0.6
    moved = session.drawn
    assert len(moved) == 120
    at = scene.moving.at(0.6).positions[session.shown.ids]
    assert np.allclose(moved.centers, session.shown.frame.shown(at), atol=1e-4)


def test_boxes_follow_and_clicks_find_what_is_there_then(scene):
    session = Session(scene)
    session.ask("red car")
    match = session.results[0].matches[0]
    for time in (0.0, 1.0):
        session.time = time
        here = Stage.of(session).placed(match)
        assert abs(here.center[1] - (-1 + 2 * time)) < 0.05
        start = session.shown.frame.shown(here.center + np.array([3.0, 0, 1]))
        way = session.shown.frame.shown(here.center) - start
        assert session.click(start, way) is not None
        assert session.results[0].matches[0].object_id == match.object_id
    session.time = 1.0
    empty = session.click(start - np.array([0.0, 20, 0]), np.array([1.0, 0, 0]))
    assert empty is None


def test_an_edited_scene_keeps_its_rows_when_it_moves(scene):
    """So that a browser is only told where they are."""
    session = Session(scene, budget=250)
    session.ask("white vase")
    session.edit(Remove())
    session.edits.add(Edit(Everything(), Move((0.0, 0.0, 1.0))))
    session.time = 0.0
    before = session.drawn
    session.time = 0.6
    after = session.drawn
    assert after.ids is before.ids
    at, car = scene.moving.at(0.6).positions, np.flatnonzero(before.ids < 100)
    there = session.shown.frame.shown(at[before.ids[car]] + [0, 0, 1])
    assert np.allclose(after.centers[car], there, atol=1e-4)
    assert not after.opacities[(before.ids >= 100) & (before.ids < 200)].any()
