"""Segmenter `graph`.

Its network is a U-Net, which sees where objects end and what each pixel has in common with others: convolutions at a
half, a quarter ... of the size, and back, joined by the features of each size. The rule for merging regions is a
network of one hidden layer. Both are trained in `world/segmenter/`.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files

import numpy as np
from PIL import Image
from safetensors.numpy import load
from scipy.ndimage import find_objects

from ....base.arrays import Doubles, Float32, Float64, Ids, Int32, MaskIds, Pixels, UInt8
from ....errors import InputError
from ....kernels import photo_regions
from ....kernels.photo_regions import Layers, PairRule, RegionGraph, Sight, lab_colors, merged_regions, region_graph
from ....kernels.photo_regions import look as look_through
from ....scene.masks.masks import Masks

WORKING_PIXELS = 640 * 480
"""Larger images are scaled down to this; sizes in pixels below are of an image of this many."""

MERGE_SCALE = 4000.0  # in CIELAB units times pixels: regions must differ by it; a higher one gives larger regions
BLUR_PIXELS = 0.5
MIN_AREA_PIXELS = 30.0
LEVELS = 5
_BLOCKS = [f"down{level}" for level in range(LEVELS)] + [f"up{level}" for level in reversed(range(LEVELS - 1))]
_LAYERS = ["stem", *(f"{block}{part}" for block in _BLOCKS for part in "ab"), "head"]

Tensors = Mapping[str, Float32[np.ndarray, "..."]]


@dataclass(frozen=True, eq=False)
class MergeRule:
    """Rule for merging regions. center, width: of each feature. threshold: pairs above it are merged."""

    center: Doubles
    width: Doubles
    hidden: Float64[np.ndarray, "n h"]
    hidden_bias: Float64[np.ndarray, " h"]
    output: Float64[np.ndarray, " h"]
    output_bias: Float64[np.ndarray, " 1"]
    threshold: Float64[np.ndarray, " 1"]

    @property
    def parts(self) -> PairRule:
        """All fields but the threshold, in the order of the native code."""
        return self.center, self.width, self.hidden, self.hidden_bias, self.output, self.output_bias


@dataclass(frozen=True)
class GraphSettings:
    """Settings of `graph`.

    least_area: of a mask, in pixels of an image of 640x480; least_width: of a mask, in pixels; both before larger
    images are scaled back. threshold: likelihood above which regions merge, None for the learned one.

    Raises: InputError: a number out of its range.
    """

    least_area: float = 60.0
    least_width: float = 2.5
    threshold: float | None = None

    def __post_init__(self) -> None:
        for name in ("least_area", "least_width"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name}: expected 0 or more pixels, got {getattr(self, name)}")
        if self.threshold is not None and not 0 <= self.threshold <= 1:
            raise InputError(f"threshold: expected 0 to 1, got {self.threshold}")


class GraphSegmenter:
    """Segmenter that cuts an image into objects by colour, borders and shape: one mask per pixel, level `large`.

    Regions of similar colour are merged while a learned rule, which uses the features of a small network, finds it
    likely that they belong to one object. Both were trained on renderings of the small world. Images of more than
    640x480 pixels are cut at that size. The same image gives the same masks at any number of threads.
    """

    name = "graph"

    def __init__(self, settings: GraphSettings | None = None, *, threads: int = 0) -> None:
        self.settings, self.threads = settings or GraphSettings(), threads
        self.network, seen = shipped_network()
        self.rule, weights = shipped_rule()
        self.identity: Mapping[str, object] = {
            "name": self.name, "version": 2, "weights": weights, "network": seen,
            "scale": MERGE_SCALE, "sigma": BLUR_PIXELS, "region_area": MIN_AREA_PIXELS,
            "working_pixels": WORKING_PIXELS, **asdict(self.settings),
        }  # fmt: skip

    def on_one_thread(self) -> "GraphSegmenter":
        """Return the same segmenter on one thread, for several threads to call at once."""
        return GraphSegmenter(self.settings, threads=1)

    def segment(self, image: Pixels) -> dict[str, Masks]:
        """Return masks of `large`, largest first; together they cover the image.

        Raises: InputError: an image without pixels.
        """
        height, width = image.shape[:2]
        if not height * width:
            raise InputError(f"an image of {width}x{height} pixels: expected at least 1x1")
        working = working_image(image)
        labels = segment_labels(working, self.rule, self.network, self.settings, threads=self.threads)
        return {"large": label_masks(enlarged(labels, height, width))}


def segment_labels(
    image: Pixels, rule: MergeRule, weights: Tensors, settings: GraphSettings, *, threads: int = 0
) -> MaskIds:
    """Return the number of each pixel's object, from 0."""
    lab = lab_colors(image, threads=threads)
    labels = small_regions(lab)
    owner = merged(region_graph(labels, lab, look(image, weights, threads=threads)), rule, settings)
    return np.asarray(owner[labels], np.int32)


def merged(graph: RegionGraph, rule: MergeRule, settings: GraphSettings) -> Ids:
    """Return the object that each region belongs to, from 0."""
    threshold = float(rule.threshold[0]) if settings.threshold is None else settings.threshold
    least_area = settings.least_area * working_share(graph.pixels)
    return merged_regions(graph, rule.parts, threshold, least_area, settings.least_width)


def label_masks(labels: MaskIds) -> Masks:
    """Return a mask per number that occurs, largest first; equal ones by number."""
    areas = np.bincount(labels.ravel())
    order = [int(i) for i in np.argsort(-areas, kind="stable") if areas[i]]
    slices = find_objects(labels + 1)
    edges = [(columns.start, rows.start, columns.stop, rows.stop) for rows, columns in (slices[i] for i in order)]
    parts = tuple(np.asarray(labels[slices[i]] == i) for i in order)
    height, width = labels.shape
    return Masks(height, width, np.array(edges, np.int32).reshape(-1, 4), parts, np.ones(len(order), np.float32))


def working_share(pixels: int) -> float:
    """Return the factor on areas for an image of this many pixels; at least a quarter, or noise becomes regions."""
    return max(pixels / WORKING_PIXELS, 0.25)


def working_image(image: Pixels) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Return the image, averaged down to WORKING_PIXELS if it has more."""
    height, width = image.shape[:2]
    shrink = (WORKING_PIXELS / (height * width)) ** 0.5
    if shrink >= 1:
        return image
    size = max(1, int(width * shrink)), max(1, int(height * shrink))
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))


def small_regions(lab: Int32[np.ndarray, "h w 3"]) -> MaskIds:
    """Label connected regions, from 0."""
    share = working_share(lab.shape[0] * lab.shape[1])
    # 255: the published code has colours from 0 to 1
    return photo_regions.small_regions(lab, MERGE_SCALE * share / 255, round(MIN_AREA_PIXELS * share))


def enlarged(labels: MaskIds, height: int, width: int) -> Int32[np.ndarray, "h2 w2"]:
    """Enlarge labels: each pixel gets the label at its centre in the working image."""
    if labels.shape == (height, width):
        return labels
    rows = (2 * np.arange(height) + 1) * labels.shape[0] // (2 * height)
    columns = (2 * np.arange(width) + 1) * labels.shape[1] // (2 * width)
    return np.asarray(labels[rows[:, None], columns], np.int32)


def shipped_network(package: str = __package__) -> tuple[Tensors, str]:
    """Return the weights in a package and the BLAKE2b hash of their file."""
    data = (files(package) / "network.safetensors").read_bytes()
    weights = {name: array.astype(np.float32) for name, array in load(data).items()}
    return weights, hashlib.blake2b(data, digest_size=8).hexdigest()


def layers_of(weights: Tensors) -> Layers:
    """Return the weights in the order of use."""
    return tuple(weights[f"{layer}.{part}"] for layer in _LAYERS for part in ("weight", "bias"))


def look(image: Pixels, weights: Tensors, *, threads: int = 0) -> Sight:
    """Run the network on an image of any size; the result has the same bits at any `threads`.

    weights: stem, down<i>a, down<i>b, up<i>a, up<i>b and head, `.weight` and `.bias`.
    """
    return look_through(image, layers_of(weights), threads=threads)


def shipped_rule() -> tuple[MergeRule, str]:
    """Return the rule in the package and the BLAKE2b hash of its file."""
    data = (files(__package__) / "rule.safetensors").read_bytes()
    return read_rule(data), hashlib.blake2b(data, digest_size=8).hexdigest()


def read_rule(data: bytes) -> MergeRule:
    """Parse the bytes of a file that `world.segmenter.tuning` wrote."""
    return MergeRule(**{name: array.astype(np.float64) for name, array in load(data).items()})
