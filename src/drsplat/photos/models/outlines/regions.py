"""Regions that outlines bound, and the orders in which they merge: that of `graph`'s rule, and that of outlines."""

from functools import cache

import numpy as np
from PIL import Image
from scipy import ndimage

from ....base.arrays import MaskIds, PixelNumbers, Pixels
from ....errors import InputError
from ....kernels.photo_regions import (
    BORDER_STEPS,
    LENGTH,
    PAIR_FEATURES,
    SEEN,
    SEEN_FEATURE,
    Layers,
    PairRule,
    Sight,
    flooded,
    lab_colors,
    merge_order,
    region_graph,
)
from ....kernels.photo_regions import look as look_through
from ....scene.masks.region_tree import RegionTree
from ..graph.segmenter import layers_of, look, shipped_network, shipped_rule, working_image

BLUR_PIXELS = 1.0
BASIN_PIXELS = 7  # side of the square in which a region begins at the lowest pixels
FLAT_STRENGTH = 0.02  # below which all pixels that touch begin one region
HEIGHT_STEPS = 4096  # of strength, in which pixels are flooded: the same order on any processor
VERSION = "2"  # of everything here
# Only the mean strength along a border counts; six digits tell strengths of 0 to 1 apart, as a likelihood hardly bends.
WEAKEST_FIRST: PairRule = (
    np.zeros(PAIR_FEATURES), np.ones(PAIR_FEATURES), -np.eye(PAIR_FEATURES)[:, [SEEN_FEATURE]],
    np.array([0.5]), np.array([4.0]), np.zeros(1),
)  # fmt: skip


@cache
def identity() -> str:
    """Return what decides a tree besides the photo: versions and hashes of the weights."""
    return " ".join([VERSION, shipped_outlines()[1], shipped_network()[1], shipped_rule()[1]])


def region_tree(image: Pixels, *, both: bool = False, threads: int = 0) -> RegionTree:
    """Return the regions of a photo and their tree, on a raster of at most 640x480 pixels; the same at any `threads`.

    Regions are basins of the outlines' strength. They merge as in `graph`, on and on: its rule says which two are
    likeliest of one thing. both: the unions of a second tree follow, in which the two merge whose outline is weakest.

    Raises: InputError: an image without pixels.
    """
    working = working_image(image)
    strength = outlines(working, threads=threads)
    labels, lab = basins(strength), lab_colors(working, threads=threads)
    sight = look(working, shipped_network()[0], threads=threads)
    graph = region_graph(labels, lab, sight)
    outlined = region_graph(labels, lab, Sight(np.round(strength * BORDER_STEPS).astype(np.int32), sight.traits))
    pairs = merge_order(graph, shipped_rule()[0].parts)
    if both:
        again = merge_order(outlined, WEAKEST_FIRST)
        pairs = np.concatenate([pairs, np.where(again < len(graph.sums), again, again + np.int32(len(pairs)))])
    strengths = outlined.borders[:, SEEN] / (2 * BORDER_STEPS)
    return RegionTree(labels, pairs, graph.pairs, outlined.borders[:, LENGTH], strengths)


def basins(strength: PixelNumbers) -> MaskIds:
    """Return the region of each pixel, from 0: a watershed of the strength of outlines."""
    smooth = ndimage.gaussian_filter(strength.astype(np.float64), BLUR_PIXELS)
    heights = np.round(smooth * HEIGHT_STEPS).astype(np.int32)
    lowest = np.maximum(ndimage.minimum_filter(heights, BASIN_PIXELS), round(FLAT_STRENGTH * HEIGHT_STEPS))
    markers, _ = ndimage.label(heights <= lowest)
    return flooded(heights, markers.astype(np.int32)) - 1


@cache
def shipped_outlines() -> tuple[Layers, str]:
    """Return the layers in the package and the BLAKE2b hash of their file."""
    weights, seen = shipped_network(__package__)
    return layers_of(weights), seen


def outlines(image: Pixels, *, threads: int = 0) -> PixelNumbers:
    """Return the strength of an outline at each pixel, 0 to 1; the same bits at any `threads`.

    It is the mean of what the network sees in the image and in the image at half its size. Images of more than 640x480
    pixels are seen at that size, so that memory is bounded, and their outlines enlarged.

    Raises: InputError: an image without pixels.
    """
    height, width = image.shape[:2]
    if not height * width:
        raise InputError(f"an image of {width}x{height} pixels: expected at least 1x1")
    full = Image.fromarray(working_image(image))
    half = full.resize(((full.width + 1) // 2, (full.height + 1) // 2), Image.Resampling.BOX)
    seen = []
    for part in (full, half):
        borders = look_through(np.asarray(part), shipped_outlines()[0], threads=threads).borders
        strength = Image.fromarray(np.asarray(borders, np.float32) / np.float32(BORDER_STEPS))
        seen.append(np.asarray(strength.resize((width, height), Image.Resampling.BILINEAR)))
    return np.asarray((seen[0] + seen[1]) / 2, np.float32)
