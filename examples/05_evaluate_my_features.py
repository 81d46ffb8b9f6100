"""Score features of any system, a row per Gaussian, under lerf-ovs@1 on the held-out photos of `drsplat demo`.

Needs (N, D) features of the demo's Gaussians in its encoder's space; without any, the demo's field is scored. Usage:
python examples/05_evaluate_my_features.py [FOLDER FEATURES.npy]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from skimage.measure import find_contours

import drsplat as ds
from drsplat.demo.household import read_household
from drsplat.evaluation.lerf_ovs import LerfScene, predict, score
from drsplat.evaluation.scorers import cosine_scorer, feature_scorer
from drsplat.formats.lerf_ovs import LabelledFrame


def main(folder: str = "drsplat-demo", features: str = "", report: str = "evaluation") -> None:
    scene, truth, frames = ds.open_scene(folder), read_household(Path(folder)), []
    views = {Path(name).stem: scene.view(name) for name in truth.held_out}
    for stem, view in views.items():  # true masks, outlined as people outlined those of LERF-OVS
        lines = {}
        for thing in ("red vase", "green toy duck", "orange sofa"):
            if outlines := find_contours(truth.mask(view.name, [thing]), 0.5):
                lines[thing] = tuple(np.int64(line[:, ::-1]) for line in outlines)
        boxes = {t: tuple(np.float64([*xy.min(0), *xy.max(0)]) for xy in lines[t]) for t in lines}
        frames.append(LabelledFrame(stem, view.width, view.height, lines, boxes))

    own = cosine_scorer(scene.field, scene.encoder)
    scorer = feature_scorer(np.load(features), scene.encoder) if features else own
    labels = LerfScene("demo", frames, views)
    predict(labels, scene.gaussians, replace(scorer, sweep=()), Path(report))
    print(score([labels], Path(report))["columns"]["fixed"]["scene_macro"])


if __name__ == "__main__":
    main(*sys.argv[1:])
