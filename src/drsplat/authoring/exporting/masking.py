"""Masks of photos drawn from what a scene knows: of the answer to a query, or of all objects."""

import json
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from ...base.arrays import Int32, Numbers
from ...drawing.heat import class_colors
from ...errors import InputError
from ...formats.field_folder import replacing_folder
from ...formats.mask_files import SUFFIX
from ...kernels import heaviest_labels, render_channels, topk_contributions
from ...query import Query, Scene
from ...query.documents import object_documents
from ...scene.photos import distort_ids
from ...scene.views import View

NAMES = "masks.json"  # beside the masks: what their numbers are
DRAWN_SIDE_PIXELS = 1600  # masks of larger photos are enlarged
WEIGHTS = 8  # of a pixel, the heaviest of which decide what it shows
MIN_COVER = 0.5  # of a pixel, by Gaussians
WHITE = 255  # also the highest number in a palette, of which 0 is nothing


class Masked(NamedTuple):
    """Masks that were written. num_shown: photos in which something is to be seen."""

    num_photos: int
    num_shown: int


def write_masks(
    folder: str | PathLike[str], scene: Scene, query: Query | str | None = None, *, overwrite: bool = False
) -> Masked:
    """Write a mask of each photo, NAME.jpg.png, on the photo as it is stored; Gaussians in front hide others.

    Args:
        folder: of the masks, with masks.json, what their numbers are; it appears whole or not at all.
        scene: with Gaussians and photos.
        query: whose sure matches are white, and all else black. None draws the objects that photos agree on in a
            palette, where 0 is nothing and an object has its own number and 1 in all photos.
        overwrite: replaces a folder of masks.

    Raises: InputError: no photos, no match, no objects, or the folder exists and not `overwrite`; as `Scene.ask`.
    """
    names, labels = _objects(scene) if query is None else _matches(scene, query)
    scene.best_view()  # or the error that says what is missing
    num_shown = 0
    with replacing_folder(Path(folder), overwrite, NAMES) as place:
        (place / NAMES).write_text(json.dumps(names, indent=1) + "\n", encoding="utf-8")
        for view in scene.views:
            numbers = _drawn(scene, view, labels) + 1
            num_shown += bool(numbers.any())
            picture = Image.fromarray(numbers.astype(np.uint8))
            if query is None:
                picture.putpalette(b"\0\0\0" + class_colors(WHITE).tobytes())
            path = place / f"{view.name}{SUFFIX}"
            path.parent.mkdir(parents=True, exist_ok=True)
            picture.resize((view.width, view.height), Image.Resampling.NEAREST).save(path)
    return Masked(len(scene.views), num_shown)


def _matches(scene: Scene, query: Query | str) -> tuple[dict[int, str], Numbers]:
    """Return what white is, and white less 1 for each Gaussian of a match, -1 for others."""
    matches = scene.locate(scene.ask(query).without_maybe())
    if not matches:
        raise InputError("no match, so no mask: `drsplat locate` prints how near it was")
    labels = np.full(len(scene.rows), -1, np.int32)
    labels[np.concatenate([match.gaussian_ids for match in matches])] = WHITE - 1
    return {WHITE: (query if isinstance(query, str) else query.text) or "query"}, labels


def _objects(scene: Scene) -> tuple[dict[int, str], Numbers]:
    """Return names by number, and the object of each Gaussian, -1 for none and for what photos do not agree on."""
    listed = [one for one in object_documents(scene, scene.objects) if one["agreed"] and one["id"] < WHITE]
    ids = scene.object_ids()
    labels = np.where(np.isin(ids, [one["id"] for one in listed]), ids, np.int32(-1))
    return {one["id"] + 1: one["label"] or one["name"] or f"object {one['id']}" for one in listed}, labels


def _drawn(scene: Scene, view: View, labels: Numbers) -> Int32[np.ndarray, "h w"]:
    """Return the label that has most weight in each pixel, on the photo as it is stored.

    -1 stands for Gaussians without a label, and for pixels of which they cover less than half.
    """
    raster = view.limited(DRAWN_SIDE_PIXELS)
    seen = scene.seen_by(view).seen(raster)
    here = labels if seen.rows is None else labels[seen.rows]
    weights = topk_contributions(seen.splats, raster, WEIGHTS, threads=scene.threads)
    alpha = render_channels(seen.splats, raster, np.empty((len(here), 0), np.float32), threads=scene.threads).alpha
    heaviest = heaviest_labels(weights, here, threads=scene.threads)
    return distort_ids(raster, np.where(alpha > MIN_COVER, heaviest, np.int32(-1)))
