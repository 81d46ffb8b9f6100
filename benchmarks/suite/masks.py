"""Masks of the photos, true or found, and their embeddings by the built-in encoder."""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import UInt8

from drsplat import MiniEncoder, View, ViewFeatures, load_image
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.masks.crops import crops
from drsplat.scene.masks.masks import LEVELS, Masks, cut_masks
from drsplat.scene.masks.selection import mask_maps

from .scenes import BenchScene

Cut = Callable[[BenchScene, View, UInt8[np.ndarray, "h w 3"]], Mapping[str, Masks]]


def true_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """One per thing or structure in the photo, in one piece or several."""
    ids = scene.ids(view)
    present = np.unique(ids[ids >= 0])
    return {"large": cut_masks(ids == present[:, None, None], np.ones(len(present), np.float32))}


def graph_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """What the built-in segmenter makes of the photo alone."""
    return GraphSegmenter().segment(image)


MASKS: dict[str, Cut] = {"true": true_masks, "graph": graph_masks}


def features_of(scene: BenchScene, kind: str, encoder: MiniEncoder) -> dict[str, ViewFeatures]:
    """Of all views, by name."""
    return {view.name: _features(scene, view, MASKS[kind], encoder) for view in scene.views}


def _features(scene: BenchScene, view: View, cut: Cut, encoder: MiniEncoder) -> ViewFeatures:
    image = load_image(view)
    maps = mask_maps(cut(scene, view, image))
    embeddings = encoder.encode_images(crops(image, maps.masks))
    return ViewFeatures(maps.mask_ids[LEVELS.index("large")], embeddings)
