"""How well `mini` knows things it never saw: python -m world.mini.measuring --test TEST.npz [--picture FILE.png]

Of each crop of a thing (structures are left out): the nearest of all names, and the nearest of all colours
as they were taught.
Training and test differ in seeds, arrangements and textures.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64
from PIL import Image, ImageDraw

from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.mini.lexicon import COLORS, NAMES

from .augment import cut_out

SEEN = 0.005  # of the picture: smaller masks are left out
CELL, MARGIN = 14, 96


def confusion(
    embeddings: Float32[np.ndarray, "n d"], truths: list[str], names: tuple[str, ...], texts: Float32[np.ndarray, "c d"]
) -> Int64[np.ndarray, "c c"]:
    """Rows: what it is; columns: the name whose text is nearest."""
    guesses = np.argmax(embeddings @ texts.T, axis=1)
    table = np.zeros((len(names), len(names)), np.int64)
    for truth, guess in zip(truths, guesses, strict=True):
        table[names.index(truth), guess] += 1
    return table


def right(table: Int64[np.ndarray, "c c"]) -> float:
    return float(np.trace(table) / table.sum())


def drawn(table: Int64[np.ndarray, "c c"], names: tuple[str, ...]) -> Image.Image:
    shares: Float64[np.ndarray, "c c"] = table / np.maximum(table.sum(1, keepdims=True), 1)
    side = MARGIN + CELL * len(names)
    picture = Image.new("RGB", (side, side), "white")
    pen = ImageDraw.Draw(picture)
    for (row, column), share in np.ndenumerate(shares):
        shade = int(255 * (1 - share**0.5))
        left, top = MARGIN + CELL * column, MARGIN + CELL * row
        color = (shade, 255 - (255 - shade) // 3, shade) if row == column else (255, shade, shade)
        pen.rectangle((left, top, left + CELL - 2, top + CELL - 2), color)
    for i, name in enumerate(names):
        at = MARGIN + CELL * i
        pen.text((MARGIN - 6, at), name, "black", anchor="ra")
        label = Image.new("L", (MARGIN - 6, CELL), 0)
        ImageDraw.Draw(label).text((0, 0), name, 255)
        picture.paste("black", (at, 0), label.rotate(90, expand=True))
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--test", type=Path, required=True)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    stored, encoder = np.load(arguments.test), MiniEncoder()
    side = stored["images"].shape[1]
    masks = np.unpackbits(stored["masks"], axis=1).reshape(-1, side, side).astype(bool)
    things = np.isin(stored["labels"][:, 0], NAMES)
    seen = np.flatnonzero(things & (masks.mean((1, 2)) >= SEEN))
    labels = stored["labels"][seen]
    crops = [cut_out(stored["images"][i], masks[i]) for i in seen]
    start = time.perf_counter()
    embeddings = encoder.encode_images(crops)
    rate = len(crops) / (time.perf_counter() - start)
    called = encoder.encode_texts(NAMES)
    names = confusion(embeddings, labels[:, 0].tolist(), NAMES, called)
    colors = confusion(embeddings, labels[:, 1].tolist(), COLORS, encoder.taught_colors)
    wrong = [(int(n), NAMES[i], NAMES[j]) for (i, j), n in np.ndenumerate(names) if i != j and n]
    report = {
        "crops": len(seen), "crops_per_second": round(rate),
        "left_out": int(things.sum()) - len(seen), "names": len(NAMES),
        "name_top1": right(names), "color_top1": right(colors),
        "worst": [f"{truth} taken for {guess}: {n}" for n, truth, guess in sorted(wrong, reverse=True)[:10]],
    }  # fmt: skip
    print(json.dumps(report, indent=1))
    if arguments.picture:
        drawn(names, NAMES).save(arguments.picture)


if __name__ == "__main__":
    main()
