"""What people read and press in the client, in the viewer and in a page, on a desk and on a phone: WCAG 2.2, AA."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from browsing import a_page, needs_chromium, opened
from clients import served
from drsplat.fronts.viewing.exporting import export_page
from drsplat.fronts.viewing.session import Session
from drsplat.query import open_scene
from drsplat.scene.labelled import Annotation
from places import SUPPORT

pytestmark = [needs_chromium, pytest.mark.slow]
SIZES = {"desk": (1100, 700), "phone": (390, 844)}
CONTRAST = (SUPPORT / "contrast.js").read_text(encoding="utf-8").partition("\n")[2]
PRESSED = "button, input, select, summary, a[href], dialog[open]"
NAMELESS = f"""() => [...document.querySelectorAll({PRESSED!r})].filter((one) => one.checkVisibility() && !(
  one.ariaLabel || one.textContent.trim() || one.labels?.length || one.title || one.getAttribute('aria-labelledby')
  || one.querySelector('img[alt]:not([alt=""])'))).map((one) => one.outerHTML.slice(0, 120))"""
SMALL = f"""() => [...document.querySelectorAll({PRESSED!r})].filter((one) => {{
  const {{ width, height }} = one.getBoundingClientRect();
  return one.checkVisibility() && width && height && (width < 24 || height < 24);
}}).map((one) => one.outerHTML.slice(0, 120))"""
OUTSIDE = "() => Math.max(0, document.documentElement.scrollWidth - innerWidth)"
DRAWERS = "() => document.querySelectorAll('details').forEach((one) => { one.open = true; })"
TOP = "() => [document.documentElement.lang, document.title, document.querySelector('meta[name=viewport]').content]"


@contextmanager
def shown(surface: str, room: Path, folder: Path) -> Iterator[str]:
    """The address of a viewer, or of a page, of a room with an answer and a note."""
    scene = open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture")
    session = Session(scene)
    session.edits.annotate(Annotation.at("a note", np.zeros(3)))
    if surface == "viewer":
        session.ask("red mug")
        with served(session) as address:
            yield address
    else:
        export_page(folder / "page.html", scene, ["red mug", "blue mug"], up=np.array([0.0, 0, 1]))
        yield (folder / "page.html").as_uri()


@pytest.mark.parametrize("surface", ["viewer", "page"])
def test_each_tab_can_be_read_and_pressed(surface, room, tmp_path, chromium):
    """Texts have contrast, what is pressed has a name and 24 x 24 pixels (2.5.8), nothing lies beside the picture."""
    with shown(surface, room, tmp_path) as address, a_page(chromium, *SIZES["desk"]) as page:
        opened(page, address)
        language, title, viewport = page.evaluate(TOP)
        assert (language, bool(title)) == ("en", True)
        assert not {"maximum-scale", "user-scalable"} & set(viewport.replace("=", ",").replace(" ", "").split(","))
        for width, height in SIZES.values():
            page.set_viewport_size({"width": width, "height": height})
            for look in ("dark", "light"):
                page.emulate_media(color_scheme=look, reduced_motion="reduce")
                for tab in page.locator("[role=tab]").all():
                    page.evaluate("(one) => one.click()", tab.element_handle())
                    page.evaluate(DRAWERS)
                    where = surface, width, look, tab.inner_text()
                    read = page.evaluate(CONTRAST)
                    assert read["count"] > 5, where
                    assert read["faults"] == [], where
                    assert page.evaluate(NAMELESS) == [], where
                    assert page.evaluate(SMALL) == [], where
                    assert page.evaluate(OUTSIDE) == 0, where
