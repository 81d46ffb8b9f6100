"""The viewer in a real browser: typed, clicked, pulled and saved, and looked at in pixels."""

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browsing import a_browser, a_page, colorfulness, eventually, near, needs_chromium, pixels_of
from drsplat import read_gaussians
from drsplat.demo.story import Story
from drsplat.field.labels import LabelFile
from drsplat.filming.looking import up_direction
from drsplat.query import open_scene
from drsplat.viewing.session import Session

pytestmark = [needs_chromium, pytest.mark.slow]
BUDGET = 30_000
STAGE = 640  # columns of the picture beside the controls
GREY = 0.15


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with a_browser() as browser:
        yield browser


@pytest.fixture(scope="module")
def session(household_story: Story, household_folder: Path) -> Session:
    return Session(open_scene(household_folder), BUDGET)


class Live:
    """The viewer of a session in a browser."""

    def __init__(self, page: Any, panel: Any) -> None:
        self.page, self.panel, self.session = page, panel, panel.session
        self.box = page.locator("textarea").first

    def ask(self, text: str) -> None:
        before = self.session.results
        self.box.fill(text)
        self.box.press("End")
        self.box.press("Enter")
        eventually(lambda: self.session.results is not before)
        self.page.get_by_text(text.split("; ")[0]).first.wait_for()

    def seen_at(self, point: np.ndarray) -> tuple[float, float]:
        """Where a place of the world is in the page."""
        window = self.panel.window
        client = next(iter(window.server.get_clients().values()))
        view = window.seen_by(client, (client.camera.image_width, client.camera.image_height))
        x, y, depth = view.K @ (view.cam_from_world[:3, :3] @ point + view.cam_from_world[:3, 3])
        return x / depth, y / depth

    def pixels(self) -> np.ndarray:
        return pixels_of(self.page, STAGE - 40)


@pytest.fixture(scope="module")
def live(session: Session, chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    pytest.importorskip("viser")
    from drsplat.viewing.panel import Panel
    from drsplat.viewing.window import Window

    own = Session(session.scene, BUDGET)
    window = Window(own, up_direction(own.scene), port=8931)
    panel = Panel(window, tmp_path_factory.mktemp("saved"))
    try:
        with a_page(chromium) as page:
            page.goto(f"http://127.0.0.1:{window.server.get_port()}")
            page.get_by_text("Query by picture").wait_for()
            eventually(lambda: len(window.server.get_clients()) == 1)
            one = Live(page, panel)
            eventually(lambda: np.ptp(one.pixels()) > 0.5)
            yield one
    finally:
        with suppress(RuntimeError):
            panel.stop()


def test_typing_a_query_highlights_the_thing(live: Live) -> None:
    assert np.median(colorfulness(live.pixels())) > 0.05
    live.ask("red vase")
    thing = live.session.results[0].matches[0]
    eventually(lambda: np.median(colorfulness(live.pixels())) < 0.05)  # the rest is grey
    assert colorfulness(near(live.pixels(), live.seen_at(thing.center))).mean() > 2 * GREY


TYPED_AT_ONCE = """(field, text) => {
  const set = Object.getOwnPropertyDescriptor(Object.getPrototypeOf(field), "value").set;
  for (let end = 1; end <= text.length; end++) {
    set.call(field, text.slice(0, end));
    field.dispatchEvent(new Event("input", { bubbles: true }));
  }
}"""


def test_what_is_typed_fast_is_asked_whole(live: Live) -> None:
    """Faster than viser's page sends: it leaves out all but the first and the last of 50 ms."""
    live.box.fill("")
    live.box.evaluate(TYPED_AT_ONCE, "red vase\n")
    eventually(lambda: [one.label for one in live.session.results] == ["red vase"])
    eventually(lambda: live.box.input_value() == "red vase")
    live.box.fill("")
    live.box.press_sequentially("candle", delay=30)
    live.box.press("Enter")
    eventually(lambda: [one.label for one in live.session.results] == ["candle"])


def test_what_is_suggested_is_found(live: Live) -> None:
    eventually(lambda: live.panel.tried.visible)
    words = live.panel.tried.options
    assert len(words) == 4
    for word in words:
        live.page.get_by_role("button", name=word, exact=True).click()
        eventually(lambda word=word: [one.label for one in live.session.results] == [word])
        assert live.session.results[0].matches


def test_finds_are_numbered_here_and_there_and_the_rest_is_behind_more(live: Live) -> None:
    live.ask("wooden table; wall; floor; wooden wall")
    total = sum(len(one.matches) for one in live.session.results)
    assert total > 12
    live.page.get_by_role("button", name=re.compile("^1 wooden table ·")).wait_for()
    assert live.page.get_by_role("button", name=re.compile("^12 ")).is_visible()
    assert not live.page.get_by_role("button", name=re.compile("^13 ")).is_visible()
    live.page.get_by_text(f"{total - 12} more", exact=True).click()
    live.page.get_by_role("button", name=re.compile("^13 ")).wait_for()
    assert "1 wooden table" in [mark.text for mark in live.panel.window._marks if hasattr(mark, "text")]
    live.ask("red vase")
    assert not live.page.get_by_role("button", name=re.compile("^2 ")).is_visible()


def test_a_click_says_the_name(live: Live) -> None:
    live.ask("red vase")
    live.page.mouse.click(*live.seen_at(live.session.results[0].matches[0].center))
    live.page.get_by_text("Seen in").wait_for()
    assert live.session.clicked is not None
    assert live.session.clicked.name == "red vase"
    assert live.page.locator("strong", has_text="red vase").count() == 1


def test_a_click_selects_the_object_and_buttons_go_up_down_and_colour_all(
    live: Live, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = live.session.scene
    monkeypatch.setattr(scene, "label_file", LabelFile(tmp_path / "room.labels.json"))
    monkeypatch.setattr(scene, "labels", scene.labels)  # and back to it: other tests ask the same scene
    live.ask("red vase")
    live.page.mouse.click(*live.seen_at(live.session.results[0].matches[0].center))
    eventually(lambda: live.session.chosen is not None)
    thing, button = live.session.chosen, lambda name: live.page.get_by_role("button", name=name, exact=True)
    assert [one.label for one in live.session.results] == ["red vase"]
    assert button("Larger").is_disabled() == (thing.larger() is None)
    if thing.larger() is not None:
        button("Larger").click()
        eventually(lambda: live.session.chosen == thing.larger())
        button("Smaller").click()
        eventually(lambda: live.session.chosen == thing)
    assert np.median(colorfulness(live.pixels())) < 0.05
    button("Everything").click()
    eventually(lambda: np.median(colorfulness(live.pixels())) > GREY)
    live.page.locator("textarea:not([aria-hidden]):visible").last.fill("my vase")
    button("Name it").click()
    live.page.locator("b", has_text="my vase").wait_for()
    button("Everything").click()
    live.ask("my vase")
    assert live.session.results[0].matches[0].label == "my vase"


def test_moving_the_slider_changes_the_selection(live: Live) -> None:
    live.ask("red vase")
    selected, before = len(live.session.selection), live.pixels()
    live.page.get_by_role("slider").first.press("Home")
    eventually(lambda: len(live.session.selection) > selected)
    eventually(lambda: np.abs(live.pixels() - before).max(axis=-1).mean() > 0.01)
    assert live.session.results[0].threshold < live.session.results[0].answer.threshold


def test_saving_writes_a_scene_that_opens(live: Live) -> None:
    live.ask("red vase")
    live.page.get_by_text("Save", exact=True).click()
    live.page.get_by_role("button", name="Scene as PLY").click()
    path = live.panel.saves.folder / "found.ply"
    eventually(path.exists)
    saved = read_gaussians(path)
    found = saved.extra["match_id"] == 0
    assert found.sum() == len(live.session.results[0].gaussian_ids)
    assert saved.extra["relevancy"][found].min() >= live.session.results[0].threshold


def test_what_is_not_there_and_what_is_not_known_is_said(live: Live) -> None:
    live.ask("laptop")
    live.page.get_by_text("No match for 'laptop'").wait_for()
    live.box.fill("xylophone")
    live.box.press("Enter")
    live.page.get_by_text("was not taught").wait_for()
    live.ask("red vase")
    eventually(lambda: live.page.get_by_text("was not taught").count() == 0)
