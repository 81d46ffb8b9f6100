"""A headless Chromium for tests, where there is one."""

import io
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PANEL = 372  # columns of the controls, on a desk
SLOW = 90_000  # milliseconds: WebGL on a busy processor
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed")


@contextmanager
def a_browser() -> Iterator[Any]:
    """One for a module of tests."""
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def a_page(browser: Any, width: int = 1000, height: int = 700) -> Iterator[Any]:
    """A page; what its scripts throw fails the test."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(SLOW)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    yield page
    page.close()
    assert errors == []


def opened(page: Any, address: str) -> None:
    """Open the client, in a page's file or before a running viewer, and wait for its first picture."""
    page.goto(address)
    page.wait_for_function("() => window.drsplat && drsplat.stage.frames > 0")
    settled(page)


def settled(page: Any) -> None:
    """Wait until what is drawn is what should be shown, all of it."""
    page.evaluate("() => Promise.all([drsplat.acting, drsplat.changing])")
    page.wait_for_function(
        "() => !drsplat.camera.isFlying && !drsplat.stage.moving && drsplat.stage.busy === 'no' && !drsplat.stage.stale"
    )
    page.wait_for_timeout(100)


def eventually(holds: Callable[[], bool], seconds: float = 90) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.3)


def near(pixels: np.ndarray, xy: tuple[float, float], radius: int = 14) -> np.ndarray:
    x, y = (round(at) for at in xy)
    return pixels[max(y - radius, 0) : y + radius, max(x - radius, 0) : x + radius]


def pixels_of(page: Any, width: int) -> np.ndarray:
    """The left `width` columns of what the page shows, as float RGB in [0, 1]."""
    shot = Image.open(io.BytesIO(page.screenshot(timeout=SLOW))).convert("RGB")
    return np.asarray(shot)[:, :width] / 255.0


def colorfulness(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(np.ptp(pixels, axis=-1))
