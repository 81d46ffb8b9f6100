"""Ask the demo's page six words that it was not made with, on a desk and on a phone, and put what it shows together.

usage: python scripts/make_words_picture.py drsplat-demo/index.html docs/images/page_words.jpg [FOLDER]

FOLDER: takes each screenshot as a PNG of full size. Needs playwright and a Chromium.
"""

import io
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from drsplat.base.arrays import UInt8
from drsplat.drawing.pictures import write_picture

WORDS = ("green mug", "something blue", "fruit", "window", "toy car", "teapot")
DESK, PHONE = (1280, 800), (390, 844)
DESK_WIDTH, GAP = 520, 8  # pixels in the picture
PATIENCE_MS = 90_000
STILL = "() => !drsplat.camera.isFlying && !drsplat.stage.moving && drsplat.stage.busy === 'no' && !drsplat.stage.stale"
ANSWERED = (
    "(word) => { const [first] = drsplat.state.results;"
    " return first?.text === word && (first.matches.length > 0 || first.instead !== undefined); }"
)


def asked(page: Any, word: str) -> Image.Image:
    """Type a word as people do, and return what the page shows once it has flown there."""
    page.fill("#query", word)
    page.press("#query", "Enter")
    page.wait_for_function(ANSWERED, arg=word)
    page.wait_for_function(STILL)
    page.wait_for_timeout(1500)
    result = page.evaluate("() => drsplat.state.results[0]")
    print(f"{word}: {result['num_matches']} matches, {result['certainty']}, {result['doubt']} {result.get('instead')}")
    return Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE_MS))).convert("RGB")


def screenshots(browser: Any, address: str, size: tuple[int, int]) -> list[Image.Image]:
    """Return a screenshot of a page for each word. Raises: SystemExit: the page was made with one of them."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark")
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    page.wait_for_function("() => window.drsplat && drsplat.stage.frames > 0")
    baked = page.evaluate("() => drsplat.backend.file.answers.map((answer) => answer.text)")
    if set(WORDS) & set(baked):
        raise SystemExit(f"the page was made with {', '.join(sorted(set(WORDS) & set(baked)))}")
    shots = [asked(page, word) for word in WORDS]
    page.close()
    return shots


def together(desks: list[Image.Image], phones: list[Image.Image]) -> UInt8[np.ndarray, "h w 3"]:
    """Put each desk beside its phone, two words in a row."""
    height = round(DESK_WIDTH * DESK[1] / DESK[0])
    narrow = round(height * PHONE[0] / PHONE[1])
    wide = DESK_WIDTH + narrow + 4 * GAP
    sheet = Image.new("RGB", (2 * wide - 3 * GAP, -(-len(WORDS) // 2) * (height + 2 * GAP) - 2 * GAP), "white")
    for number, (desk, phone) in enumerate(zip(desks, phones, strict=True)):
        left, top = number % 2 * wide, number // 2 * (height + 2 * GAP)
        sheet.paste(desk.resize((DESK_WIDTH, height), Image.Resampling.LANCZOS), (left, top))
        sheet.paste(phone.resize((narrow, height), Image.Resampling.LANCZOS), (left + DESK_WIDTH + GAP, top))
    return np.asarray(sheet)


def main() -> None:
    if len(sys.argv) not in (3, 4):
        raise SystemExit(__doc__)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        address = Path(sys.argv[1]).resolve().as_uri()
        desks, phones = (screenshots(browser, address, size) for size in (DESK, PHONE))
        browser.close()
    for place, shots in (("desk", desks), ("phone", phones)):
        for word, shot in zip(WORDS, shots, strict=True):
            if len(sys.argv) == 4:
                shot.save(Path(sys.argv[3]) / f"{place}_{word.replace(' ', '_')}.png")
    write_picture(sys.argv[2], together(desks, phones), overwrite=True)


if __name__ == "__main__":
    main()
