"""Answers of an exported page to words that it was not made with, against the engine's: how many agree, bytes, time.

    python benchmarks/bench_page.py DEMO [--words 273]

DEMO: the folder that `drsplat demo` wrote. Words: names of things, other names, colours, and pairs of them, by a fixed
draw. Each page is asked in Chromium. A word agrees where certainty, the count of sure matches and the object or place
of the best one are the engine's; "also all others" where the number of all matches is, too.
"""

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from machine import describe
from playwright.sync_api import sync_playwright

from drsplat import Scene, export_page, open_scene
from drsplat.photos.models.mini.lexicon import COLORS, GROUPS, MATERIALS, NAMES, STRUCTURES

ASKED = ["red vase", "couch", "something to eat", "laptop"]
NEAR_SHARE = 0.05  # of the size of a match
FIND = """async (texts) => {
    const search = await drsplat.backend.search;
    for (const _ of search.preparing());
    return texts.map((text) => {
        const begin = performance.now(), { result } = search.find(text);
        return [result, performance.now() - begin];
    });
}"""


def words(count: int) -> list[str]:
    """Draw words that the built-in encoder knows."""
    rng = np.random.default_rng(5)
    every = [f"{color} {name}" for color in COLORS for name in NAMES + STRUCTURES]
    made = [f"{material} {name}" for material in MATERIALS for name in NAMES]
    plain = [*NAMES, *STRUCTURES, *GROUPS, *(f"something {color}" for color in COLORS)]
    drawn = [*rng.choice(every, 120, replace=False).tolist(), *rng.choice(made, 50, replace=False).tolist()]
    return list(dict.fromkeys([*plain, *drawn]))[:count]


def agrees(scene: Scene, text: str, result: dict[str, Any]) -> tuple[bool, bool]:
    """Return whether a page's answer is the engine's, and whether all its matches are."""
    answer = scene.ask(text)
    expected, matches = scene.locate(answer), result["matches"]
    same = result["certainty"] == answer.certainty and bool(expected) == bool(matches)
    same &= sum(one["sure"] for one in matches) == sum(one.sure for one in expected)
    if same and expected:
        number = -1 if expected[0].object_id is None else expected[0].object_id
        center = np.array([float(x) for x in matches[0]["place"].split(", ")])
        near = np.linalg.norm(center - expected[0].center) < NEAR_SHARE * (1 + expected[0].extent.max())
        same &= max(matches[0]["object"], -1) == number and bool(near)
    return same, same and len(matches) == len(expected)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--words", type=int, default=273)
    given = parser.parse_args()
    texts, scene = words(given.words), open_scene(given.folder)
    plain = scene.sibling(scene.field.with_objects(None), scene.gaussians)
    print(describe())
    print("| page | MB | words that agree | also all others | ms, median |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for name, one in (("of the demo", scene), ("without objects", plain)):
            path = Path(place) / "page.html"
            export_page(path, one, ASKED, overwrite=True)
            page = opened.new_page()
            page.set_default_timeout(600_000)
            page.goto(path.as_uri())
            page.wait_for_function("() => window.drsplat && drsplat.backend.search")
            found = page.evaluate(FIND, texts)
            same = [agrees(one, text, result) for text, (result, _) in zip(texts, found, strict=True)]
            best, every = (sum(column) for column in zip(*same, strict=True))
            seconds = np.median([ms for _, ms in found])
            megabytes = path.stat().st_size / 1e6
            print(f"| {name} | {megabytes:.1f} | {best} of {len(texts)} | {every} | {seconds:.0f} |", flush=True)
            page.close()


if __name__ == "__main__":
    main()
