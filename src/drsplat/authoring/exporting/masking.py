"""Masks of photos drawn from what a scene knows: of the answer to a query, or of all objects.

`write_masks` draws pictures for people and other programs, `draw_features` what `embed` goes on from.
"""

import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from warnings import warn

import numpy as np
from PIL import Image

from ...base.arrays import Ids, MaskIds
from ...base.contents import AnyPath
from ...drawing.heat import class_colors
from ...errors import DrSplatWarning, InputError
from ...field.codes import Track, untracked
from ...field.evidence.columns import digest_of
from ...formats.embedding_record import open_record
from ...formats.field_folder import replacing_folder
from ...formats.langsplat import FeatureFolder, read_features
from ...formats.mask_files import SUFFIX
from ...formats.photo_files import listed
from ...formats.replacing import claimed_folder
from ...kernels import heaviest_labels, render_channels, topk_contributions
from ...photos.embedding.embed import finish_photo, photos_by_stem
from ...photos.embedding.keeping import WithoutEmbedding
from ...query import Query, Scene
from ...query.documents import object_documents
from ...query.objects import objects_of
from ...scene.encoders import identity_json
from ...scene.masks.masks import LEVELS
from ...scene.photo_masks import load_mask
from ...scene.photos import distort_ids
from ...scene.views import View

NAMES = "masks.json"  # beside the masks: what their numbers are
DRAWN_SIDE_PIXELS = 1600  # masks of larger photos are enlarged
WEIGHTS = 8  # of a pixel, the heaviest of which decide what it shows
MIN_COVER = 0.5  # of a pixel, by Gaussians
ALGORITHM = "1"
"""Version of everything here that decides which masks `draw_features` draws."""
WHITE = 255  # also the highest number in a palette, of which 0 is nothing


class Masked(NamedTuple):
    """Masks that were written. num_shown: photos in which something is to be seen."""

    num_photos: int
    num_shown: int


def write_masks(folder: AnyPath, scene: Scene, query: Query | str | None = None, *, overwrite: bool = False) -> Masked:
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
            numbers = _drawn(scene, view, labels)[0] + 1
            num_shown += bool(numbers.any())
            picture = Image.fromarray(numbers.astype(np.uint8))
            if query is None:
                picture.putpalette(b"\0\0\0" + class_colors(WHITE).tobytes())
            path = place / f"{view.name}{SUFFIX}"
            path.parent.mkdir(parents=True, exist_ok=True)
            picture.resize(view.size, Image.Resampling.NEAREST).save(path)
    return Masked(len(scene.views), num_shown)


def _matches(scene: Scene, query: Query | str) -> tuple[dict[int, str], Ids]:
    """Return what white is, and white less 1 for each Gaussian of a match, -1 for others."""
    matches = scene.locate(scene.ask(query).without_maybe())
    if not matches:
        raise InputError("no match, so no mask: `drsplat locate` prints how near it was")
    labels = np.full(len(scene.rows), -1, np.int32)
    labels[np.concatenate([match.gaussian_ids for match in matches])] = WHITE - 1
    return {WHITE: (query if isinstance(query, str) else query.text) or "query"}, labels


def _objects(scene: Scene) -> tuple[dict[int, str], Ids]:
    """Return names by number, and the object of each Gaussian, -1 for none and for what photos do not agree on."""
    shown = [one for one in object_documents(scene, scene.objects) if one["agreed"] and one["id"] < WHITE]
    ids = scene.object_ids()
    labels = np.where(np.isin(ids, [one["id"] for one in shown]), ids, np.int32(-1))
    return {one["id"] + 1: one["label"] or one["name"] or f"object {one['id']}" for one in shown}, labels


def draw_features(
    folder: AnyPath, scene: Scene, views: Sequence[View], *, whole: bool = False,
    overwrite: bool = False, track: Track = untracked,
) -> FeatureFolder:  # fmt: skip
    """Draw all objects into photos, as masks that `embed` and `register` read: the same number in every photo.

    A mask's number is that of its node in the field's forest. Levels default and large have things, medium the parts
    right below them, small the smallest parts, and where there is no part the thing. Pixels that a photo's own mask
    leaves out are in no mask. Finished photos stay: a killed run goes on.

    Args:
        folder: of the masks, which have no embeddings yet.
        scene: with Gaussians and objects.
        views: with photos of the scene.
        whole: things on all levels, and no parts.
        overwrite: draws all photos again.
        track: shows the progress.

    Warns: DrSplatWarning: objects that no photo shows. Raises: InputError: no objects, no photo.
    """
    objects, folder = objects_of(scene.field), Path(folder)
    levels = np.full((len(LEVELS), scene.field.num_gaussians), -1, np.int32)
    levels[:, scene.field.gaussian_ids] = things = np.append(objects.things, -1)[objects.thing_of()]
    if not whole:
        pieces = objects.piece_of()
        levels[1:3, scene.field.gaussian_ids] = (
            np.where(things < 0, things, objects.node_of), np.where(pieces < 0, things, pieces)
        )  # fmt: skip
    drawn = digest_of(levels, salt=f"{ALGORITHM} {scene.field.scene}").hex()
    settings = {"segmenter": {"objects": drawn}, "encoder": identity_json(WithoutEmbedding.identity)}
    rows = np.ones((objects.num_nodes, 1), np.float32)
    with claimed_folder(folder), closing(open_record(folder, settings, overwrite)) as record:
        for stem, view in track(list(photos_by_stem(views).items()), "masks of objects"):
            used = load_mask(replace(view, distortion=None).limited(DRAWN_SIDE_PIXELS))
            salt, used = f"{view.width}x{view.height} {view.distortion}", np.array(True) if used is None else used
            key = digest_of(view.K, view.cam_from_world, used, salt=salt).hex()
            if not record.is_finished(stem, key):
                maps = np.where(used, _drawn(scene, view, *levels), np.int32(-1))
                finish_photo(record, stem, key, maps, rows, "compact")
    masks = read_features(folder)
    shown = {node for stem in masks for node in masks[stem].file_rows.tolist()}
    if unseen := [f"object {number}" for number, node in enumerate(objects.things.tolist()) if node not in shown]:
        warn(f"{len(unseen)} objects are in front in no photo and get no mask: {listed(unseen)}",
             DrSplatWarning, stacklevel=2)  # fmt: skip
    return masks


def _drawn(scene: Scene, view: View, *labelings: Ids) -> list[MaskIds]:
    """Return, of each labelling, the label that has most weight in each pixel, on the photo as it is stored.

    -1 stands for Gaussians without a label, and for pixels of which they cover less than half.
    """
    raster = view.limited(DRAWN_SIDE_PIXELS)
    seen = scene.seen_by(view).seen(raster)
    rows = slice(None) if seen.rows is None else seen.rows
    weights = topk_contributions(seen.splats, raster, WEIGHTS, threads=scene.threads)
    none = np.empty((len(labelings[0][rows]), 0), np.float32)
    alpha = render_channels(seen.splats, raster, none, threads=scene.threads).alpha
    heaviest = [heaviest_labels(weights, labels[rows], threads=scene.threads) for labels in labelings]
    return [distort_ids(raster, np.where(alpha > MIN_COVER, most, np.int32(-1))) for most in heaviest]
