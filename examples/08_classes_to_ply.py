"""Label every Gaussian with the best of some classes, and save the scene in their colours, as any viewer shows it.

Needs a folder with a field and its scene, such as `drsplat demo` writes. Usage:
python examples/08_classes_to_ply.py [FOLDER CLASS...]
"""

import colorsys
import sys
from dataclasses import replace

import numpy as np
from PIL import Image

import drsplat as ds
from drsplat.drawing.pictures import as_pixels
from drsplat.scene.gaussians import SH_C0


def main(folder: str = "drsplat-demo", *classes: str) -> None:
    scene = ds.open_scene(folder)
    # %% Each Gaussian takes the class that fits it best, or none.
    found = scene.segment(classes or ("red vase", "couch", "houseplant", "wooden table"))
    count = len(found.names)
    for name, number in zip(found.names, found.counts, strict=True):
        print(f"{number:8,} Gaussians are {name}")

    # %% The classes as colours of the scene itself, as any viewer shows it.
    hues = [colorsys.hsv_to_rgb(number / count, 0.8, 0.9) for number in range(count)]
    rgb = np.float32([*hues, (0.4, 0.4, 0.4)])[found.labels]  # label -1, no class, takes the last
    painted = replace(scene.gaussians, sh=(rgb[:, None] - 0.5) / np.float32(SH_C0))
    ds.write_gaussians("classes.ply", painted, {"class_id": found.labels}, overwrite=True)
    view = scene.best_view(np.flatnonzero(found.labels >= 0))
    Image.fromarray(as_pixels(ds.render(painted, view).rgb)).save("classes.png")
    print("written to classes.ply, with a column class_id")


if __name__ == "__main__":
    main(*sys.argv[1:])
