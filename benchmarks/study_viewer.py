"""The viewer and its page in a browser, on the scene that `drsplat demo` writes: the pictures of docs/viewer.md.

    python benchmarks/study_viewer.py drsplat-demo FOLDER [--chromium PROGRAM] [--gaussians N]

writes viewer.jpg (three queries at once), viewer_objects.jpg (everything, and a click on the vase), viewer_page.jpg and
viewer_phone.jpg (the exported page on a desk and on a phone). Needs playwright and a Chromium.
"""

import argparse
import io
import json
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
from drsplat.viewing.listening import listening_socket
from drsplat.viewing.live.acts import done, read_act
from drsplat.viewing.live.service import Service
from drsplat.viewing.live.shared import Shared
from drsplat.viewing.saving import Saves
from drsplat.viewing.session import Session

QUERIES, PAGE = "red vase; candle; couch", ["red vase", "couch", "something to eat", "laptop"]
DESK, PHONE, QUALITY = (1280, 960), (390, 844), 80
PATIENCE = 400.0  # seconds: WebGL on a processor


@contextmanager
def browser(program: str) -> Iterator[Any]:
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()


def eventually(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        if time.monotonic() > end:
            raise TimeoutError("the browser shows nothing")
        time.sleep(0.5)


def shot(page: Any, path: Path) -> None:
    """After what was asked for last is drawn: when two pictures are the same."""
    before, end = b"", time.monotonic() + PATIENCE
    while (now := page.screenshot(timeout=1000 * PATIENCE)) != before and time.monotonic() < end:
        before = now
        page.wait_for_timeout(2000)
    Image.open(io.BytesIO(now)).convert("RGB").save(path, quality=QUALITY)
    print(f"{path}: {path.stat().st_size:,} bytes")


def viewer(opened: Any, folder: Path, output: Path, count: int) -> None:
    """The live viewer on a desk: three queries, then everything and a click on the vase."""
    session = Session(open_scene(folder), count)
    with listening_socket("127.0.0.1", 8931) as listening:
        service = Service(Shared(Saves(None), open_scene), listening, "127.0.0.1")
        service.show(session, text=QUERIES)
        with service.running() as address:
            page = opened.new_page(viewport={"width": DESK[0], "height": DESK[1]}, color_scheme="dark")
            page.set_default_timeout(1000 * PATIENCE)
            page.goto(address)
            eventually(lambda: len(session.results) == 3)
            shot(page, output / "viewer.jpg")
            eye, frame = service.shared.stage.first_look[0], session.shown.frame
            vase = session.results[0].matches[0].center
            click = {"act": "click", "origin": frame.shown(eye).tolist(), "direction": (vase - eye).tolist()}
            for act in ({"act": "mode", "mode": "objects"}, click):
                service.turns.submit(lambda act=act: done(service.shared, read_act(json.dumps(act).encode()))).result()
            shot(page, output / "viewer_objects.jpg")
            page.close()


def exported(opened: Any, folder: Path, output: Path) -> None:
    with tempfile.TemporaryDirectory() as place:
        export_page(Path(place) / "page.html", open_scene(folder), PAGE)
        for name, (width, height) in (("viewer_page", (1000, 640)), ("viewer_phone", PHONE)):
            page = opened.new_page(viewport={"width": width, "height": height}, color_scheme="dark")
            page.set_default_timeout(1000 * PATIENCE)
            page.goto((Path(place) / "page.html").as_uri())
            page.wait_for_function("window.drsplat && drsplat.play && drsplat.frames > 0")
            x, y, _ = page.evaluate("drsplat.project(drsplat.header.answers[0].matches[0].center)")
            page.mouse.click(x, y)
            shot(page, output / f"{name}.jpg")
            page.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    parser.add_argument("--gaussians", type=int, default=20_000, help="shown by the viewer (default: 20,000)")
    given = parser.parse_args()
    given.output.mkdir(exist_ok=True)
    with browser(given.chromium) as opened:
        viewer(opened, given.folder, given.output, given.gaussians)
        exported(opened, given.folder, given.output)


if __name__ == "__main__":
    main()
