"""Masks of the photos, true or found, and their embeddings by the built-in encoder."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from drsplat import MiniEncoder, View, ViewFeatures, load_image
from drsplat.masks.crops import crops
from drsplat.masks.masks import LEVELS, Masks, cut_masks
from drsplat.masks.selection import mask_maps
from drsplat.models.graph import GraphSegmenter
from drsplat.models.point_masks import PointMaskSettings, PointSegmenter

from .scenes import BenchScene, read_scene
from .simulated_sam import SimulatedSam

Cut = Callable[[BenchScene, View, UInt8[np.ndarray, "h w 3"]], Mapping[str, Masks]]


def true_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """One per thing or structure in the photo, in one piece or several."""
    ids = scene.ids(view)
    present = np.unique(ids[ids >= 0])
    return {"large": cut_masks(ids == present[:, None, None], np.ones(len(present), np.float32))}


def graph_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """What the built-in segmenter makes of the photo alone."""
    return GraphSegmenter().segment(image)


GRID = PointMaskSettings(points_per_side=32, crop_layers=0, levels=("large",))
ROUNDS = PointMaskSettings(
    points_per_side=64, first_points_per_side=4, most_points=128, crop_layers=0, levels=("large",)
)


@lru_cache(maxsize=4)
def simulated_sam(folder: Path, settings: PointMaskSettings) -> PointSegmenter:
    """Return a simulated SAM of a made room, with its points."""
    return PointSegmenter(SimulatedSam(read_scene(folder)), settings)


def grid_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """Return the masks of a simulated SAM that is asked 1,024 points."""
    return simulated_sam(scene.folder, GRID).segment(image)


def round_masks(scene: BenchScene, view: View, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
    """Return the masks of a simulated SAM that is asked coarse to fine, where no mask explains the photo yet."""
    return simulated_sam(scene.folder, ROUNDS).segment(image)


MASKS: dict[str, Cut] = {"true": true_masks, "graph": graph_masks, "grid": grid_masks, "rounds": round_masks}


def features_of(scene: BenchScene, kind: str, encoder: MiniEncoder) -> dict[str, ViewFeatures]:
    """Of all views, by name."""
    return {view.name: _features(scene, view, MASKS[kind], encoder) for view in scene.views}


def _features(scene: BenchScene, view: View, cut: Cut, encoder: MiniEncoder) -> ViewFeatures:
    image = load_image(view)
    maps = mask_maps(cut(scene, view, image))
    embeddings = encoder.encode_images(crops(image, maps.masks))
    return ViewFeatures(maps.mask_ids[LEVELS.index("large")], embeddings)
