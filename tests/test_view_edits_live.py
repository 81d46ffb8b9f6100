"""Edits, annotations and objects in a real browser, on a desktop and on a phone, looked at in pixels."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browsing import a_browser, a_page, eventually, near, needs_chromium, pixels_of
from drsplat import Scene, export_page, open_scene
from drsplat.editing import Duplicate
from drsplat.scene.annotations import Annotation
from drsplat.viewing.session import Session

pytestmark = [needs_chromium, pytest.mark.slow]
SIZES = {"desktop": (1000, 800), "phone": (390, 844)}
NOTE = np.array([255, 224, 130]) / 255
UP = np.array([0.0, 0, 1])


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with a_browser() as browser:
        yield browser


@pytest.fixture
def session(room: Path) -> Session:
    return Session(open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture"))


def is_noted(pixels: np.ndarray) -> bool:
    """Whether the colour of annotations is there."""
    return bool((np.abs(pixels - NOTE).max(axis=-1) < 0.06).any())


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_page_lists_objects_and_draws_annotations(
    session: Session, size: tuple[int, int], chromium: Any, tmp_path: Path
) -> None:
    session.ask("red mug")
    session.edit(Duplicate((0.0, 0.0, 1.0)))
    session.edits.annotate(Annotation.at("here", (0.0, 0.0, 0.6)))
    export_page(tmp_path / "page.html", session.scene, ["blue plate"], up=UP)
    with a_page(chromium, *size) as page:
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_function("window.drsplat && window.drsplat.frames > 0 && document.querySelector('#objects img')")
        page.wait_for_timeout(500)
        note = page.evaluate("drsplat.project(drsplat.header.annotations[0].center)")
        assert is_noted(near(pixels_of(page, size[0]), note[:2], 20))
        button = page.locator("#objects button").first
        button.scroll_into_view_if_needed()
        button.click()
        eventually(lambda: button.get_attribute("aria-pressed") == "true")
        target = page.evaluate("drsplat.header.objects[0].center")
        eventually(lambda: np.allclose(page.evaluate("drsplat.state.target"), target, atol=1e-3))
        page.wait_for_timeout(500)
        x, y, depth = page.evaluate("drsplat.project(drsplat.header.objects[0].center)")
        assert depth > 0
        pixels = pixels_of(page, size[0])
        assert np.ptp(near(pixels, (x, y), 8), axis=-1).mean() > 0.3  # in its own colour
        button.click()
        eventually(lambda: button.get_attribute("aria-pressed") == "false")
        box = button.bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size[0]


def test_a_page_has_what_photos_agree_less_on_behind_more(session: Session, chromium: Any, tmp_path: Path) -> None:
    field = session.scene.field
    assert field.objects is not None
    sure = field.objects.sure.copy()
    sure[field.objects.thing(0)] = 0.01
    doubted = Scene(field.with_objects(replace(field.objects, sure=sure)), session.scene.gaussians, session.scene.views)
    export_page(tmp_path / "page.html", doubted, ["blue plate"], up=UP)
    with a_page(chromium, *SIZES["desktop"]) as page:
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_function("window.drsplat && window.drsplat.frames > 0 && document.querySelector('#objects img')")
        assert page.locator("#objects button").all_inner_texts() == ["object 1"]
        hidden = page.get_by_role("button", name="object 0")
        assert not hidden.is_visible()
        page.get_by_text("More, that photos agree less on").click()
        hidden.click()
        eventually(lambda: hidden.get_attribute("aria-pressed") == "true")
        target = page.evaluate("drsplat.header.objects[1].center")
        eventually(lambda: np.allclose(page.evaluate("drsplat.state.target"), target, atol=1e-3))
