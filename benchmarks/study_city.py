"""The viewer on a street in tiles: how soon it shows what, what it holds, and pictures to look at.

    python benchmarks/bench_city.py DEMO FOLDER --rooms 30        # makes FOLDER/street30
    python benchmarks/study_city.py FOLDER/street30 PICTURES [--max-gaussians 1000000] [--ask "red vase"]

Opens `drsplat view` in a headless browser and takes pictures: first.png, the first Gaussians; near.png, all that is
wanted there; far.png, the street from afar; answer.png, the same with an answer; match.png, before its fourth match;
and viewer_city.jpg, the last two beside each other. CPU seconds and memory are the server's.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from costs import held, seconds_of
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))
from browsing import a_browser, a_page

LONG_MS = 600_000
GAP, WIDE = 16, 1400  # pixels of the joined picture
FIRST = "() => window.drsplat && drsplat.splats && drsplat.stage.frames > 0"
SETTLED = (
    "() => drsplat.isWhole && !drsplat.tiles.running && !drsplat.camera.isFlying && !drsplat.stage.moving"
    " && drsplat.stage.busy === 'no' && !drsplat.stage.stale"
)
HERE = "() => [drsplat.splats.count, drsplat.tiles.numWhole]"
AFAR = "() => { const [x, y] = drsplat.camera.target; drsplat.camera.stand([x + 10, y - 60, 45], [x + 40, y, 0]); }"


class Watched:
    """A server, whose numbers are printed with what has happened."""

    def __init__(self, server: "subprocess.Popen[str]") -> None:
        self.server, self.start = server, time.perf_counter()

    def say(self, what: str, here: Any = "") -> None:
        own, whole = held(self.server.pid)
        spent, wall = seconds_of([self.server.pid]), time.perf_counter() - self.start
        print(f"|{what}|{wall:.1f}|{spent:.1f}|{own >> 20}|{whole >> 20}|{here}|", flush=True)


def looked_at(page: Any, name: str, watched: Watched, folder: Path) -> None:
    page.wait_for_timeout(1000)
    page.wait_for_function(SETTLED, timeout=LONG_MS)
    page.screenshot(path=folder / f"{name}.png")
    watched.say(name, page.evaluate(HERE))


def joined(pictures: Path) -> None:
    """Put the pictures of the document beside each other."""
    sides = [Image.open(pictures / f"{name}.png").convert("RGB") for name in ("answer", "match")]
    width, height = sides[0].size
    both = Image.new("RGB", (2 * width + GAP, height), (255, 255, 255))
    for number, side in enumerate(sides):
        both.paste(side, (number * (width + GAP), 0))
    size = WIDE, round(WIDE * height / both.width)
    both.resize(size, Image.Resampling.LANCZOS).save(pictures / "viewer_city.jpg", quality=82)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("street", type=Path)
    parser.add_argument("pictures", type=Path)
    parser.add_argument("--max-gaussians", default="1000000")
    parser.add_argument("--ask", default="red vase")
    parser.add_argument("--port", default="18533")
    given = parser.parse_args()
    given.pictures.mkdir(parents=True, exist_ok=True)
    files = [
        str(given.street / "street.field"),
        "--scene",
        str(given.street / "street.tiles"),
        "--views",
        str(given.street),
    ]
    options = ["--port", given.port, "--json", "--threads", "1", "--max-gaussians", given.max_gaussians]
    server = subprocess.Popen(
        [sys.executable, "-m", "drsplat", "view", *files, *options], stdout=subprocess.PIPE, text=True
    )
    watched = Watched(server)
    print("|seen|s|CPU s|MiB own|with maps|Gaussians, whole tiles|\n|---|--:|--:|--:|--:|---|")
    try:
        address = json.loads(server.stdout.readline())["address"]  # type: ignore[union-attr]
        watched.say("address")
        with a_browser() as browser, a_page(browser, 1200, 750) as page:
            page.goto(address)
            page.wait_for_function(FIRST, timeout=LONG_MS)
            page.screenshot(path=given.pictures / "first.png")
            watched.say("first", page.evaluate(HERE))
            looked_at(page, "near", watched, given.pictures)
            page.evaluate(AFAR)
            looked_at(page, "far", watched, given.pictures)
            page.evaluate("(text) => drsplat.act({act: 'ask', text})", given.ask)
            looked_at(page, "answer", watched, given.pictures)
            page.evaluate("() => drsplat.flyTo(drsplat.state.results[0].matches[3])")
            looked_at(page, "match", watched, given.pictures)
        joined(given.pictures)
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
