"""The page in a real browser, opened as a file: asked, clicked, flown through, and looked at in pixels."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browsing import a_browser, a_page, colorfulness, eventually, near, needs_chromium, pixels_of
from drsplat.demo.story import Story
from drsplat.filming.looking import up_direction
from drsplat.query import open_scene
from drsplat.viewing.cameras import first_look
from drsplat.viewing.exporting import page_of
from drsplat.viewing.page import write_page
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


@pytest.fixture(scope="module")
def exported(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "room.html"
    scene = session.scene
    up = up_direction(scene)
    look = first_look(scene.views, session.shown.frame, up)
    write_page(path, page_of(session, ["red vase", "couch", "laptop"], look, up, "A <room>"))
    return path


@pytest.fixture(scope="module")
def page(exported: Path, chromium: Any) -> Iterator[Any]:
    with a_page(chromium) as one:
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
    script = "() => drsplat.project(drsplat.header.answers[drsplat.state.answer].matches[0].center)"
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
    assert "match of: red vase" in page.locator("#what p").inner_text()


def test_the_page_flies_to_a_thing(page: Any) -> None:
    press(page, "queries", "couch")
    before = page.evaluate("drsplat.state.target")
    page.locator("#matches button").first.click()
    target = page.evaluate("drsplat.header.answers[1].matches[0].center")
    eventually(lambda: np.allclose(page.evaluate("drsplat.state.target"), target, atol=1e-3))
    assert not np.allclose(before, target)
    x, y = place_of_thing(page)
    np.testing.assert_allclose((x, y), (340, 350), atol=2)  # the middle of the stage


def test_the_page_says_that_nothing_was_found(page: Any) -> None:
    press(page, "queries", "laptop")
    assert 'No match for "laptop".' in page.locator("#matches").inner_text()


def test_the_page_draws_without_webgl(exported: Path, chromium: Any) -> None:
    with a_page(chromium) as one:
        one.add_init_script(
            "const own = HTMLCanvasElement.prototype.getContext;"
            "HTMLCanvasElement.prototype.getContext = function (kind, more) {"
            " return kind === 'webgl2' ? null : own.call(this, kind, more); };"
        )
        one.goto(exported.as_uri())
        one.wait_for_function("window.drsplat && window.drsplat.frames > 0")
        settled(one)
        assert colorfulness(near(pixels_of(one, STAGE), place_of_thing(one))).mean() > 2 * GREY
