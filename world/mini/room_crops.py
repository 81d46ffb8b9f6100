"""Crops of rendered rooms, by true masks and by those of the segmenter `graph`:

python -m world.mini.room_crops ROOM [ROOM ...] --output FILE.npz [--masks both]

A segmenter's mask is of what most of its pixels show, and is left out where that is not clear. The file is
like those of `dataset`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from drsplat.base.arrays import Ids, Mask, Pixels
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.masks.masks import tight_box

from ..truth import Label, read_truth
from .dataset import SIDE

LEAST_PIXELS, CLEAR, MARGIN = 150, 0.7, 1.15
MASKS = ("true", "graph", "both")
MOST_STRUCTURES = 4  # masks of floor, wall, window and rug a photo, the others say the same again


class RoomCrop(NamedTuple):
    image: UInt8[np.ndarray, "s s 3"]
    mask: Bool[np.ndarray, "s s"]
    label: Label


def room_crops(folder: Path, masks: str) -> Iterator[RoomCrop]:
    """Those of all photos of a room."""
    truth, segmenter = read_truth(folder), GraphSegmenter()
    rng = np.random.default_rng(len(truth.labels))
    for photo, ids in truth.photos():
        found: list[tuple[np.ndarray, Label]] = []
        if masks != "graph":
            found += [(ids == k, truth.labels[k]) for k in np.unique(ids[ids >= 0]).tolist()]
        if masks != "true":
            made = segmenter.segment(photo)["large"]
            named = [(made.full(k), _label(ids[made.full(k)], truth.labels)) for k in range(len(made))]
            found += [(mask, label) for mask, label in named if label is not None]
        found = [(mask, label) for mask, label in found if mask.sum() >= LEAST_PIXELS]
        rooms = [k for k, (_, label) in enumerate(found) if not label[1]]
        spare = set(rng.permutation(rooms)[MOST_STRUCTURES:].tolist())
        yield from (_cut(photo, *pair) for k, pair in enumerate(found) if k not in spare)


def _label(ids: Ids, labels: dict[int, Label]) -> Label | None:
    """What most pixels of a mask show; None where that is not clear."""
    values, counts = np.unique(ids, return_counts=True)
    most = int(counts.argmax())
    return labels.get(int(values[most])) if counts[most] >= CLEAR * counts.sum() else None


def _cut(photo: Pixels, mask: Mask, label: Label) -> RoomCrop:
    """A square around the mask, black beyond the photo, at the size of the other crops."""
    x0, y0, x1, y1 = tight_box(mask) or (0, 0, 1, 1)
    reach = int(np.ceil(MARGIN * max(x1 - x0, y1 - y0) / 2))
    x, y = (x0 + x1) // 2, (y0 + y1) // 2
    window = (x - reach, y - reach, x + reach, y + reach)
    picture = Image.fromarray(photo).crop(window).resize((SIDE, SIDE), Image.Resampling.BILINEAR)
    cut = Image.fromarray(mask.astype(np.uint8) * 255).crop(window)
    small = np.asarray(cut.resize((SIDE, SIDE), Image.Resampling.BOX)) >= 128
    return RoomCrop(np.asarray(picture), small, label)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", type=Path, nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--masks", choices=MASKS, default="both")
    arguments = parser.parse_args()
    found = [crop for room in arguments.rooms for crop in room_crops(room, arguments.masks)]
    np.savez(
        arguments.output,
        images=np.stack([crop.image for crop in found]),
        masks=np.stack([np.packbits(crop.mask) for crop in found]),
        labels=np.array([crop.label for crop in found]),
    )
    print(f"{len(found)} crops of {len(arguments.rooms)} rooms")


if __name__ == "__main__":
    main()
