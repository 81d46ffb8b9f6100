"""Changes that need to look at the scene once, when they are made."""

import os
from pathlib import Path

import numpy as np

from ...base.arrays import Float64
from ...formats.json_files import spans_of
from ...formats.scenes import read_gaussians
from ...kernels.boxes import box_of
from ...query.objects import match_of, objects_of
from ...query.opening import find_scene, open_scene, registered_scene
from ...scene.boxes import solid
from ...scene.gaussians import Gaussians
from ...scene.moving import still
from .changes import Scale
from .replacement import Replace, placed_in

Vector = Float64[np.ndarray, " 3"]


def scaled_on_its_foot(part: Gaussians, factor: float, up: Vector | None) -> Scale:
    """Scale about the middle of where something stands; about its own middle where nothing tells what is up."""
    if up is None or not len(part):
        return Scale(factor)
    box = box_of(part, solid(part, np.arange(len(part))), up)
    x, y, z = (box.center - box.axes[2] * box.extent[2] / 2).tolist()
    return Scale(factor, (x, y, z))


def replaced_by(
    part: Gaussians, up: Vector, other: str | os.PathLike[str], number: int | None, folder: Path
) -> Replace:  # fmt: skip
    """Replace `part` by another scene, or by an object of the field in a folder. folder: where edits are kept.

    Up is as here in a scene that does not tell. Raises: InputError: no such scene or object; as `read_gaussians`.
    """
    path, up_there, spans = Path(other), up, None
    if number is None:
        gaussians = read_gaussians(path)
        ids = np.arange(len(gaussians))
    else:
        scene = open_scene(path)
        path, found = registered_scene(find_scene(path), scene.field)
        gaussians = still(found)
        up_there = up if scene.up is None else scene.up
        ids = match_of(scene.field, objects_of(scene.field).thing(number)).gaussian_ids
        spans = spans_of(ids)
    matrix = placed_in(part, np.arange(len(part)), up, gaussians, ids, up_there)
    return Replace(os.path.relpath(path.resolve(), folder.resolve()), gaussians.fingerprint, matrix, spans)
