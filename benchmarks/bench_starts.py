"""Where training starts, measured in photos that were held out: given points, triangulated ones, random ones.

    python benchmarks/bench_starts.py CAPTURE [--resolution 252] [--iterations 3000] [--starts given triangulated cube]

    given          the points of the capture
    triangulated   as a capture without points starts
    filled         those and 20,000 random ones between them, where three cameras look
    seen           20,000 random ones alone, where three cameras look
    cube           100,000 random ones in the cube that holds the cameras, as before triangulation

Settings are the defaults; every eighth photo is held out and is not triangulated from.
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np
from machine import describe

import drsplat as ds
from drsplat.formats.captures import SparsePoints
from drsplat.training.start import scene_extent, split_views
from drsplat.training.start_points import fill
from drsplat.training.triangulation import triangulate

STARTS = ("given", "triangulated", "filled", "seen", "cube")
FILLED, CUBE, GREY = 20_000, 100_000, 128


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("capture")
    parser.add_argument("--resolution", type=int, default=252, help="longer side, in pixels")
    parser.add_argument("--iterations", type=int, default=3000)
    parser.add_argument("--starts", nargs="*", choices=STARTS, default=list(STARTS))
    arguments = parser.parse_args()
    print(describe())
    views = ds.read_views(arguments.capture, max_side=arguments.resolution)
    settings = ds.TrainingSettings(iterations=arguments.iterations)
    train = split_views(views, settings.test_every).train
    print(f"{len(views)} photos of {views[0].width}x{views[0].height}, {len(train)} to train on")
    print("start          points  found in s  PSNR held out  trained on    SSIM  Gaussians")
    for name in arguments.starts:
        begin = time.perf_counter()
        points = start(name, arguments.capture, train)
        seconds = time.perf_counter() - begin
        training = ds.train(views, settings, points=points, device="cpu")
        scores = training.evaluation
        print(
            f"{name:12} {len(points.positions):8,} {seconds:11.1f} {scores.psnr:14.2f} {training.psnr_train:11.2f} "
            f"{scores.ssim:7.3f} {len(training.gaussians):10,}",
            flush=True,
        )


def start(name: str, capture: str, views: Sequence[ds.View]) -> SparsePoints:
    if name == "given":
        return ds.read_sparse_points(capture)
    rng = np.random.default_rng(0)
    extent = scene_extent(views)
    if name == "cube":
        middle = np.mean([view.center for view in views], axis=0)
        return grey(middle + rng.uniform(-extent, extent, (CUBE, 3)))
    if name == "seen":
        return grey(fill(views, np.empty((0, 3)), FILLED, rng, extent))
    found = triangulate(views)
    positions, colors = found.positions, found.colors
    if name == "filled":
        more = grey(fill(views, positions, FILLED, rng, extent))
        positions = np.concatenate([positions, more.positions])
        colors = np.concatenate([colors, more.colors])
    return SparsePoints(positions, colors)


def grey(positions: np.ndarray) -> SparsePoints:
    return SparsePoints(positions, np.full(positions.shape, GREY, np.uint8))


if __name__ == "__main__":
    main()
