"""How well boxes fit: the eight rooms of world/scenes, every thing with 40 solid Gaussians, true boxes known.

Whose a Gaussian is, is told by the true masks (the largest of its weights), so that this measures boxes and not search.

    python benchmarks/bench_boxes.py [SCENE_FOLDER ...]
"""

import json
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.optimize import linear_sum_assignment

import drsplat as ds
from drsplat.kernels import splat_arrays, view_weights
from drsplat.kernels.boxes import box_of
from drsplat.query.linking import components
from drsplat.scene.boxes import Box, upward

SCENES = Path(__file__).parent.parent / "world" / "scenes"
LEAST, SOLID = 40, 0.1
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))
ALONG = 40  # points along each side of the true box


class Case(NamedTuple):
    gaussians: ds.Gaussians
    ids: np.ndarray
    up: np.ndarray
    truth: Box


class Fit(NamedTuple):
    """iou: of volumes. corner: mean distance of corners over the true diagonal. inside: of the truth."""

    iou: float
    corner: float
    inside: float


def cases(folder: Path) -> Iterator[Case]:
    """The things of one room."""
    scene = next(iter(folder.glob("scene.*")))
    gaussians, views = ds.read_gaussians(scene), ds.read_views(folder)
    truth = json.loads((folder / "truth.json").read_text())
    owner = owners(folder, gaussians, views, len(truth["objects"]) + len(truth["structures"]))
    for thing in truth["objects"]:
        ids = largest_part(gaussians, np.flatnonzero(owner == thing["id"]))
        if np.count_nonzero(gaussians.opacities[ids] >= SOLID) >= LEAST:
            yield Case(gaussians, ids, upward(views), true_box(thing["box"]))


def largest_part(gaussians: ds.Gaussians, ids: np.ndarray) -> np.ndarray:
    """What hangs together, as `locate` has it."""
    if len(ids) < 2:
        return ids
    parts = components(gaussians.positions[ids], None)
    return ids[parts == np.bincount(parts).argmax()]


def owners(folder: Path, gaussians: ds.Gaussians, views: list[ds.View], count: int) -> np.ndarray:
    """The id of each Gaussian's thing or structure, -1 where no photo shows it."""
    splats, votes = splat_arrays(gaussians), np.zeros((len(gaussians), count))
    for view in views:
        path = folder / "ids" / f"{Path(view.name).stem}.png"
        stored = Image.open(path).resize((view.width, view.height), Image.Resampling.NEAREST)
        found = view_weights(splats, view, np.asarray(stored).astype(np.int32) - 1, None)
        np.add.at(votes, (found.gaussian_ids, found.mask_ids), found.weights)
    return np.where(votes.any(axis=1), votes.argmax(axis=1), -1)


def true_box(known: dict[str, Any]) -> Box:
    turn = np.radians(known["degrees"])
    east, north = np.cos(turn), np.sin(turn)
    axes = np.array([[east, north, 0], [-north, east, 0], [0, 0, 1.0]])
    return Box(np.array(known["center"]), axes, np.array(known["size"]))


def centres_only(gaussians: ds.Gaussians, ids: np.ndarray) -> Box:
    """What boxes were before: principal axes, the 1st to the 99th percentile of the centres."""
    points, mass = gaussians.positions[ids], gaussians.opacities[ids].astype(np.float64)
    offsets = points - mass @ points / mass.sum()
    axes = np.linalg.eigh((offsets * mass[:, None]).T @ offsets)[1].T[::-1]
    low, high = np.quantile(points @ axes.T, (0.01, 0.99), axis=0)
    return Box((low + high) / 2 @ axes, axes, high - low)


def fit(box: Box, truth: Box) -> Fit:
    steps = (np.arange(ALONG) + 0.5) / ALONG - 0.5
    grid = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    points = truth.center + (grid * truth.extent) @ truth.axes
    inside = (np.abs((points - box.center) @ box.axes.T) <= box.extent / 2).all(axis=1).mean()
    shared = inside * truth.extent.prod()
    iou = shared / (truth.extent.prod() + box.extent.prod() - shared)
    corners, others = (one.center + (CORNERS * one.extent) @ one.axes for one in (box, truth))
    apart = np.linalg.norm(corners[:, None] - others[None], axis=2)
    mean = apart[linear_sum_assignment(apart)].mean()
    return Fit(float(iou), float(mean / np.linalg.norm(truth.extent)), float(inside))


def main() -> None:
    folders = [Path(name) for name in sys.argv[1:]] or sorted(path.parent for path in SCENES.glob("*/truth.json"))
    known = [case for folder in folders for case in cases(folder)]
    ways = {
        "centres, 1 to 99 %, principal axes (before)": lambda c: centres_only(c.gaussians, c.ids),
        "`free`": lambda c: box_of(c.gaussians, c.ids),
        "`upright`": lambda c: box_of(c.gaussians, c.ids, c.up),
    }
    print(f"{len(known)} things in {len(folders)} rooms\n")
    print("| box | IoU | corners off, of the diagonal | of the truth inside | 80 % inside | 95 % inside |")
    print("|---|---|---|---|---|---|")
    for name, way in ways.items():
        fits = np.array([fit(way(case), case.truth) for case in known])
        mean, middle = fits.mean(axis=0), np.median(fits, axis=0)
        iou = f"{mean[0]:.2f} ({middle[0]:.2f})"
        corner, inside = (f"{mean[k]:.0%} ({middle[k]:.0%})" for k in (1, 2))
        shares = " | ".join(f"{(fits[:, 2] >= least).mean():.0%}" for least in (0.8, 0.95))
        print(f"| {name} | {iou} | {corner} | {inside} | {shares} |")


if __name__ == "__main__":
    main()
