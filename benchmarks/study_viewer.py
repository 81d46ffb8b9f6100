"""The viewer and its page in a browser, on the scene that `drsplat demo` writes: five tasks, and the pictures of
docs/viewer.md.

    python benchmarks/study_viewer.py drsplat-demo FOLDER [--chromium PROGRAM]

The tasks are done as a new user does them, with a mouse and a keyboard: find the candle, cut it out, name three things,
make a film, send a page. For each: presses of the mouse, texts that are typed, and seconds until what was asked for is
there to be seen (in a browser that draws on the processor). Writes viewer.jpg, viewer_edit.jpg, viewer_objects.jpg and
viewer_page.jpg. Needs playwright and a Chromium.
"""

import argparse
import io
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from drsplat import export_page, open_scene
from drsplat.fronts.viewing.live.service import Service, listening_socket
from drsplat.fronts.viewing.live.shared import Shared
from drsplat.fronts.viewing.saving import Saves
from drsplat.fronts.viewing.session import Session

PAGE = ["red vase", "couch", "something to eat", "laptop"]
DESK, PAGE_SIZE, QUALITY = (1280, 800), (1000, 640), 82
PATIENCE_MS = 90_000
STILL = "() => !drsplat.camera.isFlying && !drsplat.stage.moving && drsplat.stage.busy === 'no' && !drsplat.stage.stale"


class Person:
    """Somebody with a mouse and a keyboard, whose presses are counted."""

    def __init__(self, page: Any) -> None:
        self.page, self.presses, self.texts = page, 0, 0

    def press(self, target: Any) -> None:
        target.click()
        self.presses += 1

    def button(self, name: str) -> None:
        self.press(self.page.get_by_role("button", name=name, exact=True).first)

    def tab(self, name: str) -> None:
        self.press(self.page.locator(f"#tab-{name}"))

    def type(self, field: Any, text: str) -> None:
        self.press(field)
        self.page.keyboard.type(text)
        self.page.keyboard.press("Enter")
        self.texts += 1

    def sees(self, condition: str) -> None:
        self.page.wait_for_function(f"() => {condition}")
        self.page.wait_for_function(STILL)


def find(one: Person) -> None:
    one.type(one.page.locator("#query"), "blue candle")
    one.sees("drsplat.state.results[0]?.text === 'blue candle' && drsplat.state.results[0].matches.length")


def cut_out(one: Person) -> None:
    one.tab("edit")
    one.button("Cut out")
    one.sees("drsplat.state.edits.length === 1")
    one.press(one.page.get_by_text("Save as"))
    with one.page.expect_download() as file:
        one.button("Scene (PLY)")
    file.value.path()


def name_three(one: Person) -> None:
    one.tab("objects")
    for number, name in ((9, "grandma's vase"), (8, "my cup"), (12, "the car")):
        one.press(one.page.locator(".thing").nth([thing["number"] for thing in things(one)].index(number)))
        one.sees(f"drsplat.state.chosen?.number === {number}")
        one.type(one.page.get_by_label("Name of this object"), name)
        one.sees(f'drsplat.state.chosen?.name.includes("{name}")')


def things(one: Person) -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = one.page.evaluate("() => drsplat.header.objects")
    return listed


def film(one: Person) -> None:
    one.tab("film")
    one.button("Add key frame")
    one.page.mouse.move(800, 400)
    one.page.mouse.down()
    one.page.mouse.move(950, 380, steps=4)
    one.page.mouse.up()
    one.button("Add key frame")
    one.press(one.page.get_by_text("Save or load"))
    with one.page.expect_download() as file:
        one.button("Save the film")
    file.value.path()


def send(one: Person) -> None:
    one.tab("edit")
    if not one.page.get_by_role("button", name="Page (HTML)").is_visible():
        one.press(one.page.get_by_text("Save as"))
    with one.page.expect_download() as file:
        one.button("Page (HTML)")
    file.value.path()


def shot(page: Any, path: Path) -> None:
    """Keep what is shown, once all of it is drawn."""
    page.wait_for_function(STILL)
    page.wait_for_timeout(2000)
    Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE_MS))).convert("RGB").save(path, quality=QUALITY)
    print(f"{path}: {path.stat().st_size:,} bytes")


@contextmanager
def shown(opened: Any, address: str, size: tuple[int, int]) -> Iterator[Any]:
    page = opened.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark")
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    page.wait_for_function("() => window.drsplat && drsplat.stage.frames > 0")
    page.wait_for_function(STILL)
    yield page
    page.close()


def timed(name: str, one: Person, task: Callable[[Person], None]) -> None:
    before, begin = (one.presses, one.texts), time.perf_counter()
    task(one)
    presses, texts = one.presses - before[0], one.texts - before[1]
    print(f"{name:18} {presses:2} presses, {texts} texts, {time.perf_counter() - begin:5.1f} s")


def live(opened: Any, folder: Path, output: Path) -> None:
    session = Session(open_scene(folder))
    with listening_socket("127.0.0.1", 8931) as listening:
        service = Service(Shared(Saves(None), open_scene), listening, "127.0.0.1")
        service.show(session)
        with service.running() as address, shown(opened, address, DESK) as page:
            one = Person(page)
            timed("find the candle", one, find)
            shot(page, output / "viewer.jpg")
            timed("cut it out", one, cut_out)
            shot(page, output / "viewer_edit.jpg")
            page.get_by_role("button", name="Undo").click()
            timed("name three things", one, name_three)
            page.locator("#tab-objects").click()
            page.locator("#colours").select_option("objects")
            page.locator("#home").click()
            page.wait_for_timeout(8000)  # pictures of objects come one by one
            shot(page, output / "viewer_objects.jpg")
            timed("make a film", one, film)
            timed("send a page", one, send)


def exported(opened: Any, folder: Path, output: Path) -> None:
    with tempfile.TemporaryDirectory() as place:
        export_page(Path(place) / "page.html", open_scene(folder), PAGE)
        with shown(opened, (Path(place) / "page.html").as_uri(), PAGE_SIZE) as page:
            page.evaluate("(word) => drsplat.prompt.ask(word)", "green mug")
            page.wait_for_function("() => drsplat.state.results[0]?.text === 'green mug'")
            shot(page, output / "viewer_page.jpg")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    given = parser.parse_args()
    given.output.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        copy = Path(shutil.copytree(given.folder, Path(place) / "demo"))  # names and edits are kept beside a scene
        opened = driver.chromium.launch(executable_path=given.chromium, args=["--no-sandbox"])
        live(opened, copy, given.output)
        exported(opened, given.folder, given.output)
        opened.close()


if __name__ == "__main__":
    main()
