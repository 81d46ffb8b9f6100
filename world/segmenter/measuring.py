"""How good masks of `graph` are: python -m world.segmenter.measuring SCENE... [--picture FILE.png]

Beside it the true masks, and the regions of Felzenszwalb and Huttenlocher alone at several scales.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Int64
from skimage.segmentation import mark_boundaries

from drsplat.drawing.pictures import as_pixels, contact_sheet, write_picture
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.masks.selection import paint

from .scenes import Photo, photos
from .scores import LEAST_PIXELS, Score, score, shared_pixels

Labels = Callable[[Photo], Int64[np.ndarray, "h w"]]
BANDS = (LEAST_PIXELS, 1000, 4000, 16000, 10**9)
PLAIN_SCALES = (100, 200, 400, 800, 1600)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    parser.add_argument("--each", type=int, default=1, metavar="N", help="every Nth photo")
    parser.add_argument("--picture", type=Path, help="photos with the borders of masks")
    parser.add_argument("--plain", action="store_true", help="plain regions as well")
    arguments = parser.parse_args()
    shown = photos(arguments.scenes, arguments.each)
    print(f"{len(shown)} photos of {len(arguments.scenes)} scenes")
    print(header())
    print(row("true masks", [measured(photo, true_labels) for photo in shown]))
    start = time.process_time()
    found = [graph_labels(photo) for photo in shown]
    taken = (time.process_time() - start) / len(shown)
    print(row("graph", [scored(p, labels) for p, labels in zip(shown, found, strict=True)]))
    for scale in PLAIN_SCALES if arguments.plain else ():
        plain = [measured(photo, plain_labels(scale)) for photo in shown]
        print(row(f"plain, scale {scale}", plain))
    print(f"graph: {taken:.2f} s of one core for a photo")
    if arguments.picture:
        step = max(1, len(shown) // 6)
        pairs = list(zip(shown, found, strict=True))[::step][:6]
        drawn = [mark_boundaries(p.image, labels, (1, 1, 0), mode="inner") for p, labels in pairs]
        write_picture(arguments.picture, contact_sheet([as_pixels(picture) for picture in drawn], 3), overwrite=True)


def true_labels(photo: Photo) -> Int64[np.ndarray, "h w"]:
    return photo.truth


def graph_labels(photo: Photo) -> Int64[np.ndarray, "h w"]:
    return paint(GraphSegmenter().segment(photo.image)["large"]).astype(np.int64)


def plain_labels(scale: float) -> Labels:
    """Felzenszwalb of scikit-image in RGB, as its documentation uses it."""

    def labels(photo: Photo) -> Int64[np.ndarray, "h w"]:
        from skimage.segmentation import felzenszwalb

        share = photo.truth.size / (640 * 480)
        found = felzenszwalb(photo.image, scale * share, 0.8, max(1, round(200 * share)))
        return np.asarray(found, np.int64)

    return labels


def measured(photo: Photo, labels: Labels) -> Score:
    return scored(photo, labels(photo))


def scored(photo: Photo, labels: Int64[np.ndarray, "h w"]) -> Score:
    return score(shared_pixels(labels, photo.truth, len(photo.is_object)), photo.is_object)


def header() -> str:
    bands = [f"{low}+" for low in BANDS[:-1]]
    words = "mIoU", "IoU>.5", *bands, "structure", "masks", "purity"
    return "".join(f"{word:>10}" for word in words).rjust(110)


def row(name: str, scores: Sequence[Score]) -> str:
    """Of all things in all photos."""
    best = np.concatenate([s.best for s in scores])
    area = np.concatenate([s.area for s in scores])
    thing = np.concatenate([s.is_object for s in scores])
    own, size = best[thing], area[thing]
    by_size = [own[(size >= a) & (size < b)] for a, b in pairwise(BANDS)]
    means = [own.mean(), (own > 0.5).mean(), *(b.mean() if len(b) else np.nan for b in by_size)]
    means += [best[~thing].mean(), np.mean([s.masks for s in scores]), np.mean([s.purity for s in scores])]  # fmt: skip
    return f"{name:20}" + "".join(f"{value:10.3f}" for value in means)


if __name__ == "__main__":
    main()
