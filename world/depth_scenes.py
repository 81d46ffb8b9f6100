"""Evaluated scenes without training: Gaussians of a world folder's depth, registered with its true masks.

    python -m world.depth_scenes WORLD_FOLDER... --output SCENES [--encoder drsplat-mini | simulated-clip]

Each folder of `python -m world` becomes SCENES/NAME with scene.ply, scene.field, labels.npy (the id of
the thing that each Gaussian is of) and things.json (name, color, material of the ids). Masks are those
of ids/, cut out of the photos and embedded by the built-in encoder `mini`, or embedded by the simulation in
simulated_clip.py, which looks at no pixel. Gaussians made so lie exactly on surfaces, which trained ones
do not.
"""

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from drsplat import Gaussians, MiniEncoder, View, ViewFeatures, load_image, register
from drsplat.formats.npy import write_npy
from drsplat.formats.scenes import write_gaussians
from drsplat.masks.crops import crop

from .simulated_clip import SimulatedClip

SPACING = 0.012  # metres between Gaussians, about
MIN_PIXELS = 60  # a segmenter does not find smaller masks either
OPACITY = 0.95


def read_views(folder: Path, truth: dict) -> list[View]:
    images = next((folder / "lerf_ovs").glob("*/images"))
    return [
        View(
            view["name"], np.array(view["K"]), np.array(view["cam_from_world"]), view["width"], view["height"],
            image_path=images / view["name"],
        )
        for view in truth["views"]
    ]  # fmt: skip


def ids_of(folder: Path, view: View) -> np.ndarray:
    """Per pixel the id of the thing or structure, -1 for nothing."""
    with Image.open(folder / "ids" / Path(view.name).with_suffix(".png")) as file:
        return np.asarray(file).astype(np.int32) - 1


def points_of(folder: Path, view: View, stride: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """World points of some pixels and their ids."""
    with np.load(folder / "depth" / Path(view.name).with_suffix(".npz")) as file:
        depth = file["depth"]
    ids = ids_of(folder, view)
    rows, columns = (axis[::stride, ::stride].ravel() for axis in np.indices(depth.shape))
    z, labels = depth[rows, columns].astype(np.float64), ids[rows, columns]
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]) * z
    camera = np.linalg.solve(view.K, rays)
    rotation, shift = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3:]
    seen = (labels >= 0) & (z > 0)
    return (rotation.T @ (camera - shift)).T[seen], labels[seen]


def scene_of(folder: Path, views: list[View]) -> tuple[Gaussians, np.ndarray]:
    """One Gaussian for every occupied cell and id of a grid, and their ids."""
    points, labels = (np.concatenate(parts) for parts in zip(*(points_of(folder, view) for view in views), strict=True))
    keys = np.column_stack([np.floor(points / SPACING).astype(np.int64), labels])
    kept = np.sort(np.unique(keys, axis=0, return_index=True)[1])
    count = len(kept)
    means = points[kept].astype(np.float32)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    scales = np.full((count, 3), 0.6 * SPACING, np.float32)
    opacities, sh = np.full(count, OPACITY, np.float32), np.zeros((count, 1, 3), np.float32)
    return Gaussians(means, quats, scales, opacities, sh), labels[kept]


@dataclass(frozen=True)
class Masks:
    """The true masks of a view: mask_ids as in `ViewFeatures`, the id and the crop of each."""

    mask_ids: np.ndarray
    ids: list[int]
    crops: list[np.ndarray]


def masks_of(folder: Path, view: View) -> Masks:
    ids, photo = ids_of(folder, view), load_image(view)
    masks = Masks(np.full(ids.shape, -1, np.int32), [], [])
    for thing in np.unique(ids[ids >= 0]):
        mask = ids == thing
        if mask.sum() < MIN_PIXELS:
            continue
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        box = [int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1]
        masks.mask_ids[mask] = len(masks.ids)
        masks.ids.append(int(thing))
        masks.crops.append(crop(photo, mask[box[1] : box[3], box[0] : box[2]], box))
    return masks


def features_of(folder: Path, view: View, things: dict[int, dict], encoder: Any) -> ViewFeatures:
    """True masks and what the encoder takes them for."""
    masks = masks_of(folder, view)
    if isinstance(encoder, MiniEncoder):
        return ViewFeatures(masks.mask_ids, encoder.encode_images(masks.crops))
    embeddings = [
        encoder.encode_thing(
            f"{folder.name} {i}", view.name, *(things[i][key] for key in ("name", "color", "material"))
        )
        for i in masks.ids
    ]  # fmt: skip
    return ViewFeatures(masks.mask_ids, np.stack(embeddings))


def prepare(folder: Path, output: Path, encoder: Any) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    views = read_views(folder, truth)
    gaussians, labels = scene_of(folder, views)
    keys = ("id", "name", "color", "material")
    things = [{key: thing.get(key, "") for key in keys} for thing in (*truth["objects"], *truth["structures"])]
    by_id = {thing["id"]: thing for thing in things}
    features = {view.name: features_of(folder, view, by_id, encoder) for view in views}
    registration = replace(register(gaussians, views, features), encoder=encoder.identity)
    field = registration.to_field()
    output.mkdir(parents=True)
    write_gaussians(output / "scene.ply", gaussians)
    write_npy(output / "labels.npy", labels.astype(np.int32))
    (output / "things.json").write_text(json.dumps(things, indent=1))
    field.save(output / "scene.field")
    print(f"{output}: {len(gaussians):,} Gaussians, {len(field):,} registered, {len(things)} things")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--encoder", choices=("drsplat-mini", "simulated-clip"), default="drsplat-mini")
    arguments = parser.parse_args()
    encoder = MiniEncoder() if arguments.encoder == "drsplat-mini" else SimulatedClip()
    for folder in arguments.folders:
        if not (arguments.output / folder.name).exists():
            prepare(folder, arguments.output / folder.name, encoder)


if __name__ == "__main__":
    main()
