"""Small regions of similar colour in an image."""

import numpy as np
from PIL import Image

from ....base.arrays import Int32, UInt8
from ....kernels import photo_regions

WORKING_PIXELS = 640 * 480
"""Larger images are scaled down to this; sizes in pixels below are of an image of this many."""

MERGE_SCALE = 4000.0  # in CIELAB units times pixels: regions must differ by it; a higher one gives larger regions
BLUR_PIXELS = 0.5
MIN_AREA_PIXELS = 30.0


def working_share(pixels: int) -> float:
    """Return the factor on areas for an image of this many pixels; at least a quarter, or noise becomes regions."""
    return max(pixels / WORKING_PIXELS, 0.25)


def working_image(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Return the image, averaged down to WORKING_PIXELS if it has more."""
    height, width = image.shape[:2]
    shrink = (WORKING_PIXELS / (height * width)) ** 0.5
    if shrink >= 1:
        return image
    size = max(1, int(width * shrink)), max(1, int(height * shrink))
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))


def small_regions(lab: Int32[np.ndarray, "h w 3"]) -> Int32[np.ndarray, "h w"]:
    """Label connected regions, from 0."""
    share = working_share(lab.shape[0] * lab.shape[1])
    # 255: the published code has colours from 0 to 1
    return photo_regions.small_regions(lab, MERGE_SCALE * share / 255, round(MIN_AREA_PIXELS * share))


def enlarged(labels: Int32[np.ndarray, "h w"], height: int, width: int) -> Int32[np.ndarray, "h2 w2"]:
    """Enlarge labels: each pixel gets the label at its centre in the working image."""
    if labels.shape == (height, width):
        return labels
    rows = (2 * np.arange(height) + 1) * labels.shape[0] // (2 * height)
    columns = (2 * np.arange(width) + 1) * labels.shape[1] // (2 * width)
    return np.asarray(labels[rows[:, None], columns], np.int32)
