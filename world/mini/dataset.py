"""Crops of a split on disk: python -m world.mini.dataset --split train --count 12000 --output FILE.npz"""

import argparse
import time
from pathlib import Path

import numpy as np

from ..crops import crops
from ..looks import SPLITS

SIDE, SAMPLES = 96, 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", choices=sorted(SPLITS), required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    images = np.empty((arguments.count, SIDE, SIDE, 3), np.uint8)
    masks = np.empty((arguments.count, SIDE * SIDE // 8), np.uint8)
    labels, start = [], time.monotonic()
    for i, crop in enumerate(crops(SPLITS[arguments.split], arguments.seed, arguments.count, SIDE, SAMPLES)):
        images[i], masks[i] = crop.image, np.packbits(crop.mask)
        labels.append((crop.name, crop.color, crop.material))
        if i % 500 == 499:
            rate = (i + 1) / (time.monotonic() - start)
            print(f"{i + 1} of {arguments.count}, {rate:.1f}/s", flush=True)
    np.savez(arguments.output, images=images, masks=masks, labels=np.array(labels))


if __name__ == "__main__":
    main()
