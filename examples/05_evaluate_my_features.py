"""Score features of any system, a row per Gaussian, under lerf-ovs@1 on the held-out photos of `drsplat demo`.

Needs (N, D) features of the demo's Gaussians in its encoder's space; without any, the demo's field is scored. Usage:
python examples/05_evaluate_my_features.py [FOLDER FEATURES.npy]
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from skimage.measure import find_contours

import drsplat as ds
from drsplat.evaluation.demo.story import read_household

THINGS = ("red vase", "green toy duck", "orange sofa")


def main(folder: str = "drsplat-demo", features: str = "", report: str = "evaluation") -> None:
    place, scene, truth = Path(folder), ds.open_scene(folder), read_household(Path(folder))
    # %% The truth of the photos that were held out, as files of LERF-OVS's format.
    labels = place.parent / "label" / place.name
    labels.mkdir(parents=True, exist_ok=True)
    for name in truth.held_out:  # true masks, outlined as people outlined those of LERF-OVS
        view = scene.view(name)
        outlines = [(t, line[:, ::-1]) for t in THINGS for line in find_contours(truth.mask(name, [t]), 0.5)]
        objects = [
            {"category": thing, "segmentation": xy.tolist(), "bbox": [*xy.min(0), *xy.max(0)]} for thing, xy in outlines
        ]
        info = {"name": Path(name).name, "width": view.width, "height": view.height}
        (labels / Path(name).with_suffix(".json").name).write_text(json.dumps({"info": info, "objects": objects}))

    # %% Features of any system, or the scene with its own field, are asked for each label and drawn into these photos.
    judged = (scene.gaussians, np.load(features), scene.encoder) if features else scene
    answer = ds.evaluate("lerf-ovs", place.parent, {place.name: judged}, report, figures=0, overwrite=True)
    print(answer["columns"]["fixed"]["scene_macro"])

    # %% What the first word selects in one of them.
    Image.fromarray(scene.picture(truth.held_out[0], scene.ask(THINGS[0]), photo=True)).save("judged.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
