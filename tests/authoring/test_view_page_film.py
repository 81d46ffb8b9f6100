"""The page's film, looks, keys and its sheet on a phone, in a real browser, on a desk and in a hand."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from browsing import SLOW, eventually, needs_chromium, opened, pixels_of, settled
from drsplat.authoring.filming.paths import CameraPath, KeyFrame, write_path
from drsplat.errors import InputError
from drsplat.fronts.viewing.exporting import export_page
from page_files import read_page
from scenes import look_at_view
from viewing_scenes import THINGS, boxes_scene

DESK, HAND = (1280, 800), (390, 844)


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """Two queries, and a film past two places in 2 seconds."""
    folder = tmp_path_factory.mktemp("page")
    eyes = ((0.0, -4.0, 1.0), (3.0, -3.0, 1.5), (3.5, 0.0, 1.0))
    keys = [KeyFrame.of(look_at_view(eye, fov_degrees=fov)) for eye, fov in zip(eyes, (60.0, 50.0, 40.0), strict=True)]
    write_path(folder / "path.json", CameraPath(keys, seconds=2.0))
    queries = ["red mug", "tall lamp"]
    export_page(folder / "page.html", boxes_scene(), queries, words=THINGS, path_name=str(folder / "path.json"))
    return folder / "page.html"


def test_a_page_has_the_path_in_its_own_frame(exported):
    film = read_page(exported)[0]["film"]
    assert film["seconds"] == 2.0
    assert len(film["eyes"]) == len(film["targets"]) == len(film["fovs"]) == 24
    eyes = np.array(film["eyes"])
    ends = np.array([(0.0, -4.0, 1.0), (3.5, 0.0, 1.0)])
    scale = np.linalg.norm(eyes[-1] - eyes[0]) / np.linalg.norm(ends[1] - ends[0])
    origin = eyes[0] - scale * ends[0]
    assert_allclose(eyes[-1] - scale * ends[1], origin, atol=1e-3)
    ahead = np.array(film["targets"]) - eyes
    middle = eyes[0] + ahead[0] / np.linalg.norm(ahead[0]) * scale * np.linalg.norm(ends[0])
    assert_allclose(middle, origin, atol=0.01)  # all look at the world's zero


def test_without_a_path_the_film_is_an_orbit(tmp_path):
    export_page(tmp_path / "page.html", boxes_scene(), ["red mug"], words=THINGS)
    film = read_page(tmp_path / "page.html")[0]["film"]
    assert_allclose(film["eyes"][0], film["eyes"][-1], atol=1e-3)
    assert np.ptp(film["eyes"], axis=0).max() > 1
    with pytest.raises(InputError, match="orbit, swing, photos or a file"):
        export_page(tmp_path / "other.html", boxes_scene(), ["red mug"], words=THINGS, path_name="orbti")


# --- in a browser ---


@contextmanager
def device(chromium: Any, file: Path, size: tuple[int, int], scheme: str = "dark", hand: bool = False) -> Iterator[Any]:
    """Open the page as a device shows it that is set to a look; what its scripts throw fails the test."""
    viewport = {"width": size[0], "height": size[1]}
    context = chromium.new_context(viewport=viewport, color_scheme=scheme, has_touch=hand, is_mobile=hand)
    errors = []
    page = context.new_page()
    page.set_default_timeout(SLOW)
    page.on("pageerror", lambda error: errors.append(str(error)))
    opened(page, file.as_uri())
    yield page
    context.close()
    assert errors == []


def place_of(page: Any) -> np.ndarray:
    return np.array(page.evaluate("() => [...drsplat.camera.eye, ...drsplat.camera.target]"))


def paper_of(page: Any) -> float:
    """How light the panel is, from 0 to 1."""
    page.wait_for_timeout(400)
    pixels = pixels_of(page, 10_000)
    return float(pixels[5, 5].mean())


@needs_chromium
@pytest.mark.slow
def test_the_film_plays_stops_and_is_pulled(exported, chromium):
    with device(chromium, exported, DESK) as page:
        before = place_of(page)
        page.locator("#tab-film").click()
        page.locator("#play").click()
        eventually(lambda: not np.allclose(place_of(page), before))
        eventually(lambda: not page.evaluate("() => drsplat.film.isPlaying"))
        assert page.locator("#at").input_value() == "1000"
        fovs = read_page(exported)[0]["film"]["fovs"]
        assert page.evaluate("() => drsplat.camera.fov") == pytest.approx(fovs[-1])
        page.locator("#at").fill("0")
        eventually(lambda: page.evaluate("() => drsplat.camera.fov") == fovs[0])
        page.evaluate("() => { drsplat.header.film.seconds = 1000; }")  # longer than a slow machine takes to press
        page.locator("#at").blur()
        page.keyboard.press("Space")
        assert page.evaluate("() => drsplat.film.isPlaying")
        assert page.locator("#play").inner_text() == "Stop"
        page.mouse.click(800, 20)  # a hand on the scene stops it
        eventually(lambda: not page.evaluate("() => drsplat.film.isPlaying"))
        eventually(lambda: page.locator("#tab-film").get_attribute("aria-selected") == "true")
        assert page.locator("#play").inner_text() == "Play"


@needs_chromium
@pytest.mark.slow
def test_the_look_is_the_systems_until_somebody_chooses(exported, chromium):
    with device(chromium, exported, DESK, "light") as page:
        assert paper_of(page) > 0.8
        page.emulate_media(color_scheme="dark")
        assert paper_of(page) < 0.2
        page.get_by_role("button", name="Look: system").click()
        page.get_by_role("button", name="Look: dark").click()
        page.get_by_role("button", name="Look: light").wait_for()
        assert paper_of(page) > 0.8


@needs_chromium
@pytest.mark.slow
def test_keys_ask_turn_and_help(exported, chromium):
    with device(chromium, exported, DESK) as page:
        for key, text in (("2", "tall lamp"), ("1", "red mug")):
            page.keyboard.press(key)
            eventually(lambda text=text: page.evaluate("() => drsplat.state.results[0].text") == text)
        page.keyboard.press("c")
        eventually(lambda: page.evaluate("() => drsplat.state.mode") == "heat map")
        settled(page)
        yaw = page.evaluate("() => drsplat.camera.yaw")
        page.keyboard.press("ArrowLeft")
        assert page.evaluate("() => drsplat.camera.yaw") == pytest.approx(yaw - 0.08)
        assert not page.locator("#keys").is_visible()
        page.keyboard.press("?")
        assert page.locator("#keys").is_visible()
        page.keyboard.press("Escape")
        eventually(lambda: not page.locator("#keys").is_visible())
        page.keyboard.press("/")
        page.keyboard.type("tall")
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Enter")
        eventually(lambda: page.evaluate("() => drsplat.state.results[0].text") == "tall lamp")
        page.keyboard.press("Escape")
        page.locator("#home").click()
        begin = page.evaluate("() => drsplat.header.target")
        eventually(lambda: np.allclose(page.evaluate("() => drsplat.camera.target"), begin, atol=1e-3))


@needs_chromium
@pytest.mark.slow
def test_in_a_hand_the_controls_are_a_sheet(exported, chromium):
    with device(chromium, exported, HAND, hand=True) as page:
        assert page.evaluate("() => document.documentElement.scrollWidth") == HAND[0]
        assert page.evaluate("() => drsplat.camera.height") > 0.4 * HAND[1]
        low = page.evaluate(
            "() => [...document.querySelectorAll('button, select, #query')].filter((one) => one.offsetParent)"
            ".filter((one) => one.id !== 'sheet' && Math.min(one.offsetHeight, one.offsetWidth) < 40)"
            ".map((one) => one.outerHTML)"
        )
        assert low == []  # a finger's size
        page.locator("#query").fill("tall lamp")
        page.locator("#ask").tap()
        eventually(lambda: page.evaluate("() => drsplat.state.results[0].text") == "tall lamp")
        settled(page)
        page.locator("#sheet").tap()
        eventually(lambda: page.evaluate("() => drsplat.camera.height") > 0.85 * HAND[1])
        assert page.locator("#sheet").get_attribute("aria-expanded") == "false"
        page.evaluate(
            "() => { const m = drsplat.header.answers[1].matches[0]; drsplat.camera.stand(m.eye, m.center); }"
        )
        settled(page)
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.header.answers[1].matches[0].center)")
        page.touchscreen.tap(x, y)
        page.locator("#sheet").tap()
        eventually(lambda: "tall lamp" in page.locator("#what b").inner_text())
        eventually(lambda: page.evaluate("() => drsplat.camera.height") < 0.6 * HAND[1])
