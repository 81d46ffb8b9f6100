"""Draw what the built-in eyes see in a photo: its masks, and its outlines.

usage: python scripts/make_eyes_picture.py plush/20240212_003932.jpg docs/images/eyes.jpg
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from drsplat.base.arrays import UInt8
from drsplat.drawing.pictures import write_picture
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.outlines import outlines
from drsplat.scene.masks.selection import mask_maps

WIDTH, HEIGHT, GAP = 480, 320, 6


def panels(photo: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h wide 3"]:
    """Return the photo, the masks of `graph` in their mean colours with white borders, and the outlines in black."""
    ids = mask_maps(GraphSegmenter().segment(photo)).mask_ids[-1]
    masks = np.full_like(photo, 255)
    for number in range(ids.max() + 1):
        masks[ids == number] = photo[ids == number].mean(axis=0)
    inside = np.ones_like(ids, np.bool_)
    inside[1:] &= ids[1:] == ids[:-1]
    inside[:, 1:] &= ids[:, 1:] == ids[:, :-1]
    masks[~inside] = 255
    drawn = np.repeat(np.uint8(255 * (1 - outlines(photo)))[..., None], 3, axis=2)
    gap = np.full((len(photo), GAP, 3), 255, np.uint8)
    return np.concatenate([photo, gap, masks, gap, drawn], axis=1)


def main() -> None:
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    with Image.open(sys.argv[1]) as image:
        photo = ImageOps.fit(image.convert("RGB"), (WIDTH, HEIGHT))
    write_picture(Path(sys.argv[2]), panels(np.asarray(photo)))


if __name__ == "__main__":
    main()
