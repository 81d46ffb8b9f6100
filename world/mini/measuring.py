"""How well `mini` knows things it never saw: python -m world.mini.measuring --test TEST.npz [--picture FILE.png]

Of each crop, cut out by its true mask: the nearest of all names, and the nearest of all colours. Training and
test differ in seeds, arrangements and textures.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64
from PIL import Image, ImageDraw

from drsplat.mini import MiniEncoder
from drsplat.mini.lexicon import COLORS, NAMES

from .augment import cut_out

SEEN = 0.005  # of the picture: smaller masks are left out
CELL, MARGIN = 14, 96


def confusion(
    embeddings: Float32[np.ndarray, "n d"],
    truths: list[str],
    names: tuple[str, ...],
    encoder: MiniEncoder,
) -> Int64[np.ndarray, "c c"]:
    """Rows: what it is; columns: what it was taken for."""
    guesses = np.argmax(embeddings @ encoder.encode_texts(names).T, axis=1)
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
    seen = np.flatnonzero(masks.mean((1, 2)) >= SEEN)
    labels = stored["labels"][seen]
    crops = [cut_out(stored["images"][i], masks[i]) for i in seen]
    start = time.perf_counter()
    embeddings = encoder.encode_images(crops)
    rate = len(crops) / (time.perf_counter() - start)
    names = confusion(embeddings, labels[:, 0].tolist(), NAMES, encoder)
    colors = confusion(embeddings, labels[:, 1].tolist(), COLORS, encoder)
    wrong = [(int(n), NAMES[i], NAMES[j]) for (i, j), n in np.ndenumerate(names) if i != j and n]
    report = {
        "crops": len(seen), "crops_per_second": round(rate), "left_out": len(masks) - len(seen), "names": len(NAMES),
        "name_top1": right(names), "color_top1": right(colors),
        "worst": [f"{truth} taken for {guess}: {n}" for n, truth, guess in sorted(wrong, reverse=True)[:10]],
    }  # fmt: skip
    print(json.dumps(report, indent=1))
    if arguments.picture:
        drawn(names, NAMES).save(arguments.picture)


if __name__ == "__main__":
    main()
