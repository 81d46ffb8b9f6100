"""The viewer and its page in a real browser: typed, clicked, pulled and saved, and looked at in pixels."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsing import a_page, colorfulness, needs_chromium, pixels_of

from drsplat import read_gaussians
from drsplat.asking import open_scene
from drsplat.demo.story import Story
from drsplat.viewing.cameras import first_look, up_direction
from drsplat.viewing.exporting import page_of
from drsplat.viewing.page import write_page
from drsplat.viewing.session import Session

pytestmark = [needs_chromium, pytest.mark.slow]
BUDGET = 30_000
STAGE = 640  # columns of the picture beside the controls
GREY = 0.15


@pytest.fixture(scope="module")
def session(household_story: Story, household_folder: Path) -> Session:
    return Session(open_scene(household_folder), BUDGET)


def near(pixels: np.ndarray, xy: tuple[float, float], radius: int = 14) -> np.ndarray:
    x, y = (round(at) for at in xy)
    return pixels[max(y - radius, 0) : y + radius, max(x - radius, 0) : x + radius]


def eventually(holds: Callable[[], bool], seconds: float = 90) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.3)


# --- the page ---


@pytest.fixture(scope="module")
def exported(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "room.html"
    scene = session.scene
    up = up_direction(scene.views)
    look = first_look(scene.views, session.shown.frame, up)
    write_page(path, page_of(session, ["red vase", "couch", "laptop"], look, up, "A <room>"))
    return path


@pytest.fixture(scope="module")
def page(exported: Path) -> Iterator[Any]:
    pytest.importorskip("playwright.sync_api")
    with a_page() as one:
        requests: list[str] = []
        one.on("request", lambda request: requests.append(request.url))
        one.goto(exported.as_uri())
        one.wait_for_function("window.drsplat && window.drsplat.frames > 0")
        yield one
        outside = [url for url in requests if not url.startswith(("file:", "blob:", "data:"))]
        assert outside == []


def settled(page: Any) -> None:
    page.wait_for_timeout(300)
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 50)))")


def place_of_thing(page: Any) -> tuple[float, float]:
    script = "() => drsplat.project(drsplat.header.answers[drsplat.state.answer].things[0].center)"
    x, y, depth = page.evaluate(script)
    assert depth > 0
    return x, y


def press(page: Any, row: str, label: str) -> None:
    page.locator(f"#{row} button", has_text=label).first.click()
    settled(page)


def test_the_page_names_itself_as_text(page: Any) -> None:
    assert page.title() == "A <room>"
    assert page.locator("h1").inner_text() == "A <room>"


def test_the_page_highlights_what_was_asked(page: Any) -> None:
    press(page, "queries", "red vase")
    press(page, "modes", "answer")
    xy, pixels = place_of_thing(page), pixels_of(page, STAGE)
    assert colorfulness(near(pixels, xy)).mean() > 3 * GREY
    assert np.median(colorfulness(pixels)) < 0.05
    press(page, "modes", "as it is")
    assert np.median(colorfulness(pixels_of(page, STAGE))) > 0.05


def test_the_page_has_a_heat_map_and_features(page: Any) -> None:
    press(page, "queries", "red vase")
    press(page, "modes", "heat map")
    warm, xy = pixels_of(page, STAGE), place_of_thing(page)
    red, _, blue = near(warm, xy).reshape(-1, 3).mean(0)
    assert red > blue
    middle = np.median(warm.reshape(-1, 3), axis=0)
    assert middle[2] > middle[0]  # the rest is cold
    press(page, "modes", "features")
    assert np.abs(pixels_of(page, STAGE) - warm).mean() > 0.05


def test_a_click_in_the_page_names_the_thing(page: Any) -> None:
    press(page, "queries", "red vase")
    press(page, "modes", "answer")
    page.mouse.click(*place_of_thing(page))
    eventually(lambda: "vase" in page.locator("#what b").inner_text())
    assert "found for: red vase" in page.locator("#what p").inner_text()


def test_the_page_flies_to_a_thing(page: Any) -> None:
    press(page, "queries", "couch")
    before = page.evaluate("drsplat.state.target")
    page.locator("#things button").first.click()
    target = page.evaluate("drsplat.header.answers[1].things[0].center")
    eventually(lambda: np.allclose(page.evaluate("drsplat.state.target"), target, atol=1e-3))
    assert not np.allclose(before, target)
    x, y = place_of_thing(page)
    np.testing.assert_allclose((x, y), (340, 350), atol=2)  # the middle of the stage


def test_the_page_says_that_nothing_was_found(page: Any) -> None:
    press(page, "queries", "laptop")
    assert 'Nothing found for "laptop".' in page.locator("#things").inner_text()


def test_the_page_draws_without_webgl(exported: Path) -> None:
    with a_page() as one:
        one.add_init_script(
            "const own = HTMLCanvasElement.prototype.getContext;"
            "HTMLCanvasElement.prototype.getContext = function (kind, more) {"
            " return kind === 'webgl2' ? null : own.call(this, kind, more); };"
        )
        one.goto(exported.as_uri())
        one.wait_for_function("window.drsplat && window.drsplat.frames > 0")
        settled(one)
        assert colorfulness(near(pixels_of(one, STAGE), place_of_thing(one))).mean() > 2 * GREY


# --- the viewer ---


class Live:
    """The viewer of a session in a browser."""

    def __init__(self, page: Any, panel: Any) -> None:
        self.page, self.panel, self.session = page, panel, panel.session
        self.box = page.locator("form input:not([type=hidden])").first

    def ask(self, text: str) -> None:
        self.box.fill(text)
        self.box.press("Enter")
        eventually(lambda: [r.label for r in self.session.results] == text.split("; "))
        self.page.get_by_text(text.split("; ")[0]).first.wait_for()
        self.page.wait_for_timeout(2500)

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
def live(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    pytest.importorskip("viser")
    pytest.importorskip("playwright.sync_api")
    from drsplat.viewing.panel import Panel
    from drsplat.viewing.window import Window

    own = Session(session.scene, BUDGET)
    window = Window(own, up_direction(own.scene.views), port=8931)
    panel = Panel(window, tmp_path_factory.mktemp("saved"))
    try:
        with a_page() as page:
            page.goto(f"http://127.0.0.1:{window.server.get_port()}")
            page.get_by_text("Look for a picture").wait_for()
            eventually(lambda: len(window.server.get_clients()) == 1)
            page.wait_for_timeout(4000)
            yield Live(page, panel)
    finally:
        with suppress(RuntimeError):
            window.stop()


def test_typing_a_query_highlights_the_thing(live: Live) -> None:
    before = live.pixels()
    live.ask("red vase")
    thing = live.session.results[0].found[0].thing
    after, xy = live.pixels(), live.seen_at(thing.center)
    assert colorfulness(near(after, xy)).mean() > 3 * GREY
    assert np.median(colorfulness(after)) < 0.05
    assert np.median(colorfulness(before)) > 0.05


def test_a_click_says_the_name(live: Live) -> None:
    live.ask("red vase")
    live.page.mouse.click(*live.seen_at(live.session.results[0].found[0].thing.center))
    live.page.get_by_text("Seen in").wait_for()
    assert live.session.clicked is not None
    assert live.session.clicked.name == "red vase"
    assert live.page.locator("strong", has_text="red vase").count() == 1


def test_moving_the_slider_changes_the_selection(live: Live) -> None:
    live.ask("red vase")
    selected, before = len(live.session.selection), live.pixels()
    slider = live.page.get_by_role("slider").first
    slider.focus()
    for _ in range(60):
        slider.press("ArrowLeft")
    eventually(lambda: len(live.session.selection) > selected)
    live.page.wait_for_timeout(2500)
    assert np.abs(live.pixels() - before).max(axis=-1).mean() > 0.001
    assert live.session.results[0].threshold < live.session.results[0].asked.threshold


def test_saving_writes_a_scene_that_opens(live: Live) -> None:
    live.ask("red vase")
    live.page.get_by_text("Save", exact=True).click()
    live.page.get_by_role("button", name="Scene as PLY").click()
    path = live.panel.folder / "found.ply"
    eventually(path.exists)
    saved = read_gaussians(path)
    found = saved.extra["object_id"] == 0
    assert found.sum() == len(live.session.results[0].gaussian_ids)
    assert saved.extra["relevancy"][found].min() >= live.session.results[0].threshold


def test_what_is_not_there_and_what_is_not_known_is_said(live: Live) -> None:
    live.ask("laptop")
    live.page.get_by_text("Nothing found for 'laptop'").wait_for()
    live.box.fill("xylophone")
    live.box.press("Enter")
    live.page.get_by_text("was not taught").wait_for()
