"""Count things: how many places of a scene answer each text, where they are and how large.

Needs a folder with a field and its scene, such as `drsplat demo` writes. Usage:
python examples/04_count.py [FOLDER TEXT...]
"""

import sys

import numpy as np
from PIL import Image

import drsplat as ds


def main(folder: str = "drsplat-demo", *texts: str) -> None:
    scene, counted = ds.open_scene(folder), [np.empty(0, np.int64)]
    # %% Each text is looked for by itself; what is not there has no match.
    for text in texts or ("something to eat", "red vase", "toy duck", "laptop"):
        matches = scene.locate(text, min_gaussians=100)  # smaller ones are specks
        print(f"{len(matches)} x {text}")
        for match in matches:
            width, depth, height = match.extent
            counted.append(match.gaussian_ids)
            print(f"    at {match.center.round(2)}, {width:.2f} x {depth:.2f} x {height:.2f}")

    # %% All that was counted, in the photo that shows most of it.
    Image.fromarray(scene.picture(shown=np.concatenate(counted), photo=True)).save("counted.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
