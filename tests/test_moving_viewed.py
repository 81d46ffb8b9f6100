"""Time in the viewer: what is shown, asked and clicked at a time; and a slider in a real browser."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from browsing import a_browser, a_page, eventually, near, needs_chromium, pixels_of
from drsplat.editing import Edit, Everything, Move, Remove
from drsplat.query import Scene
from drsplat.viewing.playing import placed_now
from drsplat.viewing.session import Mode, Session
from moving_scenes import passing_red_scene

CAR = np.arange(100)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return passing_red_scene()


def test_what_is_shown_moves_with_the_time(scene: Scene) -> None:
    session = Session(scene)
    assert session.drawn is session.shown
    session.time = 1.0
    moved, frame = session.drawn, session.shown.frame
    at = scene.moving.at(1.0)
    assert np.allclose(moved.centers, frame.shown(at.positions), atol=1e-4)
    assert moved.frame is frame
    assert np.array_equal(moved.covariances[100:], session.shown.covariances[100:])
    assert np.abs(moved.centers[:100] - session.shown.centers[:100]).max() > 1
    assert np.array_equal(session.edited()[0].means, at.means)


def test_fewer_than_all_move_as_well(scene: Scene) -> None:
    session = Session(scene, budget=120)
    session.time = 0.6
    moved = session.drawn
    assert len(moved) == 120
    at = scene.moving.at(0.6).positions[session.shown.ids]
    assert np.allclose(moved.centers, session.shown.frame.shown(at), atol=1e-4)


def test_boxes_follow_and_clicks_find_what_is_there_then(scene: Scene) -> None:
    session = Session(scene)
    session.ask("red car")
    match = session.results[0].matches[0]
    for time in (0.0, 1.0):
        session.time = time
        here = placed_now(session, match)
        assert abs(here.center[1] - (-1 + 2 * time)) < 0.05
        start = session.shown.frame.shown(here.center + np.array([3.0, 0, 1]))
        way = session.shown.frame.shown(here.center) - start
        assert session.click(start, way) is not None
        assert session.results[0].matches[0].object_id == match.object_id
    session.time = 1.0
    empty = session.click(start - np.array([0.0, 20, 0]), np.array([1.0, 0, 0]))
    assert empty is None


def test_queries_of_a_span_ask_it(scene: Scene) -> None:
    session = Session(scene)
    session.during = (0.0, 0.3)
    session.ask("red car")
    seen = {scene.view(one.view_name).time for one in session.results[0].matches[0].support}
    assert seen
    assert max(time for time in seen if time is not None) <= 0.3


def test_an_edited_scene_keeps_its_rows_when_it_moves(scene: Scene) -> None:
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


STAGE = 640


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with a_browser() as browser:
        yield browser


class Live:
    def __init__(self, page: Any, panel: Any) -> None:
        self.page, self.panel, self.session = page, panel, panel.session

    def redness_at(self, point: np.ndarray) -> float:
        """Where a place of the world is in the page: how much more red than green is there."""
        window = self.panel.window
        client = next(iter(window.server.get_clients().values()))
        view = window.seen_by(client, (client.camera.image_width, client.camera.image_height))
        x, y, depth = view.K @ (view.cam_from_world[:3, :3] @ point + view.cam_from_world[:3, 3])
        part = near(pixels_of(self.page, 1000), (x / depth, y / depth), 6)
        return float((part[..., 0] - part[..., 1]).max(initial=0))


@pytest.fixture
def live(scene: Scene, chromium: Any) -> Iterator[Live]:
    pytest.importorskip("viser")
    from drsplat.viewing.panel import Panel
    from drsplat.viewing.window import Window

    session = Session(scene)
    session.mode = Mode.SCENE
    panel = Panel(Window(session, np.array([0.0, 0, 1]), port=8947))
    try:
        with a_page(chromium) as page:
            page.goto(f"http://127.0.0.1:{panel.window.server.get_port()}")
            page.get_by_text("Query by picture").wait_for()
            eventually(lambda: len(panel.window.server.get_clients()) == 1)
            eventually(lambda: np.ptp(pixels_of(page, STAGE)) > 0.5)
            yield Live(page, panel)
    finally:
        with suppress(RuntimeError):
            panel.stop()


@needs_chromium
@pytest.mark.slow
def test_the_slider_moves_the_scene_and_play_goes_on(live: Live) -> None:
    """The red car is where it is at the first time, then where it is at the last, and then it moves by itself."""
    begin, end = (np.array([0.0, y, 0.2]) for y in (-1.0, 1.0))
    assert live.session.time == 0
    eventually(lambda: live.redness_at(begin) > 0.3 > live.redness_at(end))
    live.page.get_by_role("slider").first.press("End")  # nothing was asked: there is no threshold above it
    eventually(lambda: live.session.time == 1)
    eventually(lambda: live.redness_at(end) > 0.3 > live.redness_at(begin))
    live.page.get_by_label("Play").first.check(force=True)
    eventually(lambda: live.session.time not in (None, 1))
    stepped = {live.session.time}
    eventually(lambda: stepped.add(live.session.time) or len(stepped) > 2)
    live.page.get_by_label("Play").first.uncheck(force=True)
    assert stepped <= set(live.session.scene.moving.times.tolist())
