"""Segmenter `graph`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from ....base.arrays import Int32, UInt8
from ....errors import InputError
from ....kernels.photo_regions import RegionGraph, lab_colors, merged_regions, region_graph
from ....scene.masks.masks import Masks
from . import regions
from .network import Tensors, look, shipped_network
from .rule import MergeRule, shipped_rule


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
            "scale": regions.MERGE_SCALE, "sigma": regions.BLUR_PIXELS, "region_area": regions.MIN_AREA_PIXELS,
            "working_pixels": regions.WORKING_PIXELS, **asdict(self.settings),
        }  # fmt: skip

    def on_one_thread(self) -> "GraphSegmenter":
        """Return the same segmenter on one thread, for several threads to call at once."""
        return GraphSegmenter(self.settings, threads=1)

    def segment(self, image: UInt8[np.ndarray, "h w 3"]) -> dict[str, Masks]:
        """Return masks of `large`, largest first; together they cover the image.

        Raises: InputError: an image without pixels.
        """
        height, width = image.shape[:2]
        if not height * width:
            raise InputError(f"an image of {width}x{height} pixels: expected at least 1x1")
        working = regions.working_image(image)
        labels = segment_labels(working, self.rule, self.network, self.settings, threads=self.threads)
        return {"large": label_masks(regions.enlarged(labels, height, width))}


def segment_labels(
    image: UInt8[np.ndarray, "h w 3"], rule: MergeRule, weights: Tensors, settings: GraphSettings, *, threads: int = 0
) -> Int32[np.ndarray, "h w"]:
    """Return the number of each pixel's object, from 0."""
    lab = lab_colors(image, threads=threads)
    labels = regions.small_regions(lab)
    owner = merged(region_graph(labels, lab, look(image, weights, threads=threads)), rule, settings)
    return np.asarray(owner[labels], np.int32)


def merged(graph: RegionGraph, rule: MergeRule, settings: GraphSettings) -> Int32[np.ndarray, " n"]:
    """Return the object that each region belongs to, from 0."""
    threshold = float(rule.threshold[0]) if settings.threshold is None else settings.threshold
    least_area = settings.least_area * regions.working_share(graph.pixels)
    return merged_regions(graph, rule.parts, threshold, least_area, settings.least_width)


def label_masks(labels: Int32[np.ndarray, "h w"]) -> Masks:
    """Return a mask per number that occurs, largest first; equal ones by number."""
    from scipy.ndimage import find_objects

    areas = np.bincount(labels.ravel())
    order = [int(i) for i in np.argsort(-areas, kind="stable") if areas[i]]
    slices = find_objects(labels + 1)
    boxes = np.array([_box(slices[i]) for i in order], np.int32).reshape(-1, 4)
    parts = tuple(np.asarray(labels[slices[i]] == i) for i in order)
    height, width = labels.shape
    return Masks(height, width, boxes, parts, np.ones(len(order), np.float32))


def _box(place: tuple[slice, slice]) -> tuple[int, int, int, int]:
    rows, columns = place
    return columns.start, rows.start, columns.stop, rows.stop
