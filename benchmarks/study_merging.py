"""Levels of detail by merging, beside the heaviest Gaussians of the same number: PSNR to the picture of all of them.

    python benchmarks/study_merging.py SCENE [SCENE ...] [--up +z] [--weights 0 10 30 100]

Each level is merged from the one before, to half of its Gaussians. --weights are those of differences of colours
(`COLOUR_WEIGHT`), of which the code has one. "heaviest": the Gaussians of most opacity times area, as they are. The
pictures are those of `study_lod.py`: five of 480 x 360 pixels, two of the whole scene and three inside it.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np
from study_lod import cameras, psnr

from drsplat.authoring.filming.looking import named_up
from drsplat.drawing.rendering import render
from drsplat.formats.scenes import read_gaussians
from drsplat.scene import merging
from drsplat.scene.gaussians import Gaussians

SHARES = (2, 4, 8, 16)  # of which a level has one Gaussian each


def merged_levels(gaussians: Gaussians, weight: float) -> Iterator[Gaussians]:
    count = len(gaussians)
    with patch.object(merging, "COLOUR_WEIGHT", weight):
        for share in SHARES:
            gaussians = merging.coarser(gaussians, count // share).gaussians
            yield gaussians


def heaviest_levels(gaussians: Gaussians) -> Iterator[Gaussians]:
    order = np.argsort(-merging.masses_of(gaussians), kind="stable")
    for share in SHARES:
        yield gaussians.subset(np.sort(order[: len(gaussians) // share]))


def study(scene: Path, up: np.ndarray, weights: Sequence[float]) -> None:
    gaussians = read_gaussians(scene)
    views = cameras(gaussians, up)
    whole = [render(gaussians, view).rgb for view in views]

    def show(name: str, levels: Iterator[Gaussians]) -> None:
        scores = [
            np.mean([psnr(render(level, view).rgb, picture) for view, picture in zip(views, whole, strict=True)])
            for level in levels
        ]
        print(f"| {name} |", " | ".join(f"{score:.1f}" for score in scores), "|", flush=True)

    print(f"\n{scene.name}, {len(gaussians):,} Gaussians: PSNR in dB of a half, a quarter, an eighth and a sixteenth")
    for weight in weights:
        name = f"merged, weight {weight:g}{' (the code)' if weight == merging.COLOUR_WEIGHT else ''}"
        show(name, merged_levels(gaussians, weight))
    show("heaviest", heaviest_levels(gaussians))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--up", default="+z")
    parser.add_argument("--weights", type=float, nargs="+", default=[0.0, 10.0, 30.0, 100.0])
    given = parser.parse_args()
    for scene in given.scenes:
        study(scene, named_up(given.up), given.weights)


if __name__ == "__main__":
    main()
