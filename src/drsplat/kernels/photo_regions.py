"""A photo to regions of like colour, what a network sees of them, and which are one thing (native).

All sums are of whole numbers, so that they do not depend on order: colours are in steps of 1 / LAB_STEPS of CIELAB,
traits in steps of 1 / TRAIT_STEPS, borders in steps of 1 / BORDER_STEPS.
"""

from dataclasses import dataclass

import numpy as np

from .. import _native
from ..base.arrays import DoubleRows, Doubles, Float32, Float64, Ids, Int32, MaskIds, PixelNumbers, Pixels
from .splats import checked_isa, native, native_array

LAB_STEPS = 16
TRAITS = 8
TRAIT_STEPS, BORDER_STEPS = 32, 255
MAX_TRAIT = 127 * TRAIT_STEPS

BINS_PER_CHANNEL = 12  # of the histogram
AREA, MEAN, SQUARE, FRAME, AROUND, TEXTURE = 0, slice(1, 4), slice(4, 7), 7, 8, 9
HISTOGRAM = slice(10, 10 + 3 * BINS_PER_CHANNEL)
TRAIT = slice(HISTOGRAM.stop, HISTOGRAM.stop + TRAITS)
TRAIT_SQUARE = TRAIT.stop
COLUMNS = TRAIT_SQUARE + 1
LENGTH, STEP, STEP_CHROMA, SEEN, TRAIT_STEP = range(5)
PAIR_FEATURES, SEEN_FEATURE = 42, 36  # what a rule asks of a pair; the mean of SEEN along its border

Layers = tuple[Float32[np.ndarray, "..."], ...]
PairRule = tuple[Float64[np.ndarray, "..."], ...]
"""center and width of each feature, hidden weights (features, units) and their bias, output weights and their bias."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Output of the network. borders: likelihood, 0 to BORDER_STEPS, that a pixel touches another thing.

    traits: near each other for pixels of one thing.
    """

    borders: MaskIds
    traits: Int32[np.ndarray, "h w t"]


@dataclass(frozen=True, eq=False)
class RegionGraph:
    """Graph of an image's regions; an edge joins two that touch.

    sums: columns as named above: pixels, colours and their squares, pixels at the image's frame, length of the border
    to other regions, texture, histograms, traits and their squares. boxes: x0, y0, -x1, -y1. pairs: first below second,
    in order. borders: length in pixel sides, sum of colour steps across, of chroma alone, what the network says of the
    pixels on both sides, steps of traits.
    """

    pixels: int
    sums: DoubleRows
    boxes: Float64[np.ndarray, "n 4"]
    pairs: Int32[np.ndarray, "e 2"]
    borders: Float64[np.ndarray, "e 5"]


def lab_colors(image: Pixels, *, threads: int = 0, isa: str = "") -> Int32[np.ndarray, "h w 3"]:
    """Return CIELAB in steps of 1 / LAB_STEPS; the same on any processor.

    Raises: InputError: an image without pixels, or of 2^16 or more to a side.
    """
    return native_array("colours", _native.lab_colors, image, threads, checked_isa(isa))


def small_regions(lab: Int32[np.ndarray, "h w 3"], scale: float, least: int) -> MaskIds:
    """Return the region of each pixel, numbered from 0 by first pixel; every region is connected.

    scale: how unlike neighbours must be, in CIELAB units times pixels: higher, larger regions. least: pixels of a
    region. Neighbours that differ equally are merged in a fixed order: side by side, above each other, diagonally, each
    by rows.

    Raises: InputError: as lab_colors.
    Source: Felzenszwalb and Huttenlocher 2004, Efficient graph-based image segmentation; with sigma 0.5.
    """
    return native_array("regions", _native.small_regions, lab, scale, least).reshape(lab.shape[:2])


def look(image: Pixels, layers: Layers, *, threads: int = 0, isa: str = "") -> Sight:
    """Return what a U-Net sees in an image of any size; the same bits at any `threads`.

    layers: weights (9 * inputs, outputs), rows in the order of row, column, channel, and bias of each 3x3 convolution
    and ReLU in turn: the first, two for each level down, two for each level up; then of the head (inputs, 4 (1 +
    TRAITS)): for each pixel of a 2x2 block, rows first, within each channel. The photo's 2x2 blocks come in like that.

    Raises: InputError: as lab_colors, or layers that do not fit together.
    """
    return Sight(*native("network", _native.look, image, layers, threads, checked_isa(isa)))


def people(image: Pixels, layers: Layers, *, threads: int = 0, isa: str = "") -> PixelNumbers:
    """Return how likely each pixel shows a person, 0 to 1; the same bits at any `threads`.

    image: of sides that are a multiple of 16, and 1 more. layers: weights and bias of each in turn, of MobileNetV2 and
    the head of DeepLabv3 for the 21 classes of VOC: a 3x3 convolution; depthwise (9, channels) and narrow layer of the
    first block; wide, depthwise and narrow layer of each of 16 more; then of each place, of the mean of all, of both
    together, and of the classes. Activations end at 6, those of the head do not.

    Raises: InputError: as lab_colors, other sides, or layers that do not fit together.
    Source: Sandler et al. 2018, MobileNetV2; Chen et al. 2017, Rethinking Atrous Convolution.
    Twin: tests/twins/people_network.py::people.
    """
    return native_array("network", _native.people, image, layers, threads, checked_isa(isa))


def region_graph(labels: MaskIds, lab: Int32[np.ndarray, "h w 3"], sight: Sight) -> RegionGraph:
    """Return the sums over regions and over the borders between them.

    labels: from 0, every number up to the largest in use.

    Raises: InputError: as lab_colors, labels below 0, or arrays of different sizes.
    """
    given = labels, lab, sight.borders, sight.traits
    sums, boxes, pairs, borders = native("regions", _native.photo_graph, *given)
    return RegionGraph(
        labels.size, sums.reshape(-1, COLUMNS), boxes.reshape(-1, 4), pairs.reshape(-1, 2), borders.reshape(-1, 5)
    )


def pair_likelihoods(graph: RegionGraph, rule: PairRule, *, isa: str = "") -> Doubles:
    """Return how likely the regions of each pair belong to one thing, 0 to 1, rounded to six digits.

    Raises: InputError: a graph or rule of other shapes, pairs that are not in order.
    """
    return native_array("regions", _native.pair_likelihoods, _arrays(graph), graph.pixels, rule, checked_isa(isa))


def merged_regions(
    graph: RegionGraph, rule: PairRule, threshold: float, least_area: float, least_width: float, *, isa: str = ""
) -> Ids:
    """Return the thing of each region, from 0 in the order of the lowest region of each.

    The likeliest pair is merged, of equal ones the first, until none is above the threshold. Then regions with fewer
    pixels than least_area, or narrower than least_width as a strip of their area and border to others, go to their
    likeliest neighbour, smallest first.

    Raises: InputError: as pair_likelihoods.
    Twin: tests/twins/photo_merging.py::Merging.
    """
    given = _arrays(graph), graph.pixels, rule, threshold, least_area, least_width
    return native_array("regions", _native.merged_regions, *given, checked_isa(isa))


def merge_order(graph: RegionGraph, rule: PairRule, *, isa: str = "") -> Int32[np.ndarray, "k 2"]:
    """Return which two become one, likeliest first, until no two touch.

    Regions go by their numbers, unions by those after them, in their order. Of equally likely pairs it is the first one
    by the lowest regions of both.

    Raises: InputError: as pair_likelihoods.
    Twin: tests/twins/photo_merging.py::Merging.
    """
    return native_array("regions", _native.merge_order, _arrays(graph), graph.pixels, rule, checked_isa(isa)).reshape(
        -1, 2
    )


def flooded(heights: MaskIds, markers: MaskIds) -> MaskIds:
    """Return the marker that each pixel is flooded from: a watershed.

    Lowest pixels first, of equal ones those that were reached first, along the sides of pixels. markers: numbers from 1
    on, 0 for none; what no marker reaches stays 0.

    Raises: InputError: as lab_colors, or arrays of different sizes.
    Source: Beucher and Meyer 1993, by a queue.
    Twin: tests/twins/photo_regions.py::flooded.
    """
    return native_array("watershed", _native.flooded, heights, markers).reshape(heights.shape)


def _arrays(graph: RegionGraph) -> tuple[np.ndarray, ...]:
    return graph.sums, graph.boxes, graph.pairs, graph.borders
