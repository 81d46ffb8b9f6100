"""What an edit of a whole thing leaves behind, and what it takes of others, in made rooms whose meshes are known.

python benchmarks/study_loose_parts.py FOLDER...

FOLDER: as `drsplat demo` writes it, or a room of world/scenes with a field and its objects: a scene, photos' poses,
ids/, truth.json, a field. A Gaussian is the thing's whose mesh is nearest, up to 5 cm; within 6 mm of two it is
nobody's. Of each thing the object that fits it best is taken, at IoU 0.3 and more. left: weight of its Gaussians that
stay, drawn without the others, per pixel that shows it; taken: weight of others' Gaussians that go, drawn in the whole
scene, as a share of these pixels. Both in up to 8 photos, before (what is enclosed and what hangs on) and now.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from world.looks import SPLITS
from world.meshes import Mesh, areas
from world.rooms import make_room

from drsplat import View, open_scene
from drsplat.editing.resolving import completed
from drsplat.kernels import render_channels, splat_arrays

FAR, BETWEEN = 0.05, 0.006  # metres
SPACING = {True: 0.004, False: 0.015}  # metres between points on things, and on walls and floors
PHOTOS, SIDE, LEAST_PIXELS = 8, 320, 20


def points_on(mesh: Mesh, spacing: float, rng: np.random.Generator) -> np.ndarray:
    size = areas(mesh.vertices, mesh.faces)
    face = mesh.faces[rng.choice(len(size), max(50, int(size.sum() / spacing**2)), p=size / size.sum())]
    root, v = np.sqrt(rng.random((len(face), 1))), rng.random((len(face), 1))
    a, b, c = (mesh.vertices[face[:, corner]] for corner in range(3))
    return np.asarray(a * (1 - root) + b * root * (1 - v) + c * root * v)


def true_owners(folder: Path, places: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """The thing of each place, -1 for nobody's; names of the things."""
    truth, rng = json.loads((folder / "truth.json").read_text(encoding="utf-8")), np.random.default_rng(0)
    room = make_room(SPLITS[truth["split"]], truth["seed"])
    meshes = [[mesh for _, mesh in thing.part_meshes()] for thing in room.objects]
    meshes += [[mesh for _, mesh in one.pieces] for one in room.structures]
    nearest, second, owner = np.full(len(places), np.inf), np.full(len(places), np.inf), np.full(len(places), -1)
    for number, parts in enumerate(meshes):
        spacing = SPACING[number < len(room.objects)]
        points = np.concatenate([points_on(mesh, spacing, rng) for mesh in parts])
        distance = cKDTree(points).query(places, distance_upper_bound=2 * FAR)[0]
        second = np.minimum(second, np.maximum(distance, nearest))
        owner, nearest = np.where(distance < nearest, number, owner), np.minimum(distance, nearest)
    names = [thing["category"] for thing in truth["objects"]]
    return np.where((nearest > FAR) | (second < nearest + BETWEEN), -1, owner), names


def rows_of(folder: Path) -> Iterator[tuple[str, list[tuple[float, float]]]]:
    """Each thing's name, and (left, taken) before and now."""
    scene = open_scene(folder)
    truth, names = true_owners(folder, scene.gaussians.positions)
    objects = scene.object_ids().astype(np.int64)
    sizes = np.bincount(objects[objects >= 0])
    every = sorted(scene.views, key=lambda view: view.name)
    views = [view.limited(SIDE) for view in every[:: max(1, len(every) // PHOTOS)]][:PHOTOS]
    for number, name in enumerate(names):
        own = truth == number
        both = np.bincount(objects[own & (objects >= 0)], minlength=len(sizes))
        fits = both / (sizes + own.sum() - both)
        if fits.max() < 0.3:
            continue
        ids = np.flatnonzero(objects == fits.argmax())
        ways = [completed(scene.gaussians, ids, objects, agreed) for agreed in (np.zeros(0, bool), scene.agreed)]
        shown = [(view, pixels) for view in views if (pixels := _pixels(folder, view, number)).sum() >= LEAST_PIXELS]
        if shown:
            yield name, [_left_and_taken(scene, rows, own, truth >= 0, shown) for rows in ways]


def _pixels(folder: Path, view: View, number: int) -> np.ndarray:
    stored = Image.open(folder / "ids" / f"{Path(view.name).stem}.png")
    return np.asarray(stored.resize((view.width, view.height), Image.Resampling.NEAREST)).astype(int) == number + 1


def _left_and_taken(scene, rows, own, known, shown) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    goes = np.isin(np.arange(len(own)), rows)
    after = splat_arrays(scene.gaussians.subset(np.flatnonzero(~goes)))
    left, taken = own[~goes, None].astype(np.float32), (goes & known & ~own)[:, None].astype(np.float32)
    stays = sum(render_channels(after, view, left).channels[..., 0][pixels].sum() for view, pixels in shown)
    wrong = sum(render_channels(scene.splats, view, taken).channels.sum() for view, _ in shown)
    area = sum(np.count_nonzero(pixels) for _, pixels in shown)
    return float(stays) / area, float(wrong) / area


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    numbers = []
    for folder in parser.parse_args().folders:
        for name, (before, now) in rows_of(folder):
            numbers.append((before, now))
            print(f"| {folder.name} | {name} | " + " | ".join(f"{x:.3f}" for x in (*before, *now)) + " |", flush=True)
    all_of = np.array(numbers)
    for number, way in enumerate(("before", "now")):
        left, taken = all_of[:, number].T
        print(
            f"{way}: left {left.mean():.3f} (median {np.median(left):.3f}, above 5 %: {(left > 0.05).sum()} of "
            f"{len(left)}), taken {taken.mean():.3f} (median {np.median(taken):.3f})"
        )


if __name__ == "__main__":
    main()
