"""Masks of the photos, true or found, and their embeddings by the built-in encoder."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from drsplat import MiniEncoder, View, ViewFeatures, load_image
from drsplat.fronts.commands.embed import COARSE_TO_FINE, NESTED_MASKS
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.point_masks import PointMaskSettings, PointSegmenter
from drsplat.scene.masks.crops import crops
from drsplat.scene.masks.masks import LEVELS, Masks, cut_masks
from drsplat.scene.masks.selection import mask_maps

from .scenes import BenchScene, read_scene
from .simulated_sam import room_sam

Cut = Callable[[BenchScene, View, UInt8[np.ndarray, "h w 3"]], Mapping[str, Masks]]


def true_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """One per thing or structure in the photo, in one piece or several."""
    ids = scene.ids(view)
    present = np.unique(ids[ids >= 0])
    return {"large": cut_masks(ids == present[:, None, None], np.ones(len(present), np.float32))}


def graph_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """What the built-in segmenter makes of the photo alone."""
    return GraphSegmenter().segment(image)


_PHOTO = PointMaskSettings(crop_layers=0, levels=("large",))
ASKING = {
    "grid16": replace(_PHOTO, points_per_side=16),
    "grid32": _PHOTO,
    "nested32": replace(_PHOTO, **NESTED_MASKS),
    "rounds": replace(_PHOTO, **COARSE_TO_FINE, **NESTED_MASKS),
}
"""How a simulated SAM is asked: by a grid of 256 or of 1,024 points; by the latter, but masks within others stay, as in
rounds; or coarse to fine, where no mask explains the photo."""


def asking(kind: str) -> tuple[PointMaskSettings, int]:
    """Return how a simulated SAM is asked and the number of its draw, as in "rounds" and "rounds.2"."""
    way, _, draw = kind.partition(".")
    return ASKING[way], int(draw or 0)


@lru_cache(maxsize=4)
def simulated_sam(folder: Path, kind: str) -> PointSegmenter:
    """Return a simulated SAM of a made room. kind: as in `asking`."""
    settings, draw = asking(kind)
    return PointSegmenter(room_sam(read_scene(folder), draw), settings)


def _asking(kind: str) -> Cut:
    return lambda scene, view, image: simulated_sam(scene.folder, kind).segment(image)


MASKS: dict[str, Cut] = {"true": true_masks, "graph": graph_masks, **{kind: _asking(kind) for kind in ASKING}}


def cut_of(kind: str) -> Cut:
    """Return what makes the masks of a kind of MASKS, or of another draw of a simulated SAM."""
    return MASKS[kind] if kind in MASKS else _asking(kind)


def features_of(scene: BenchScene, kind: str, encoder: MiniEncoder) -> dict[str, ViewFeatures]:
    """Of all views, by name."""
    return {view.name: _features(scene, view, MASKS[kind], encoder) for view in scene.views}


def _features(scene: BenchScene, view: View, cut: Cut, encoder: MiniEncoder) -> ViewFeatures:
    image = load_image(view)
    maps = mask_maps(cut(scene, view, image))
    embeddings = encoder.encode_images(crops(image, maps.masks))
    return ViewFeatures(maps.mask_ids[LEVELS.index("large")], embeddings)
