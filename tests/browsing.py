"""A headless Chromium for tests, where there is one."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SLOW = 90_000  # milliseconds: WebGL on a busy processor
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed")


@contextmanager
def a_page(width: int = 1000, height: int = 700) -> Iterator[Any]:
    """A page; what its scripts throw fails the test."""
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(SLOW)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page
        browser.close()
        assert errors == []


def pixels_of(page: Any, width: int) -> np.ndarray:
    """The left `width` columns of what the page shows, as float RGB in [0, 1]."""
    import io

    shot = Image.open(io.BytesIO(page.screenshot(timeout=SLOW))).convert("RGB")
    return np.asarray(shot)[:, :width] / 255.0


def colorfulness(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(np.ptp(pixels, axis=-1))
