"""An image to small regions of like colour."""

import numpy as np
from jaxtyping import Int32, Int64, UInt8
from PIL import Image

WORKING_PIXELS = 640 * 480
"""Larger images are scaled down to this; sizes in pixels below are of an image of this many."""
LAB_STEPS = 16
"""Of one unit of CIELAB: colours are whole numbers, so that sums over pixels are exact."""

SCALE = 4000.0  # how unlike neighbours must be, in CIELAB units times pixels: higher, larger regions
SIGMA = 0.5  # pixels that are blurred before
LEAST_AREA = 30.0


def working_share(pixels: int) -> float:
    """By which areas are smaller in an image of so many; below a quarter noise would become regions."""
    return max(pixels / WORKING_PIXELS, 0.25)


def working_image(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h2 w2 3"]:
    """The image, averaged down to WORKING_PIXELS where it has more."""
    height, width = image.shape[:2]
    shrink = (WORKING_PIXELS / (height * width)) ** 0.5
    if shrink >= 1:
        return image
    size = max(1, int(width * shrink)), max(1, int(height * shrink))
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))


def lab_colors(image: UInt8[np.ndarray, "h w 3"]) -> Int32[np.ndarray, "h w 3"]:
    """CIELAB in steps of 1 / LAB_STEPS."""
    from skimage.color import rgb2lab

    return np.asarray(np.rint(rgb2lab(image) * LAB_STEPS), np.int32)


def small_regions(lab: Int32[np.ndarray, "h w 3"]) -> Int64[np.ndarray, "h w"]:
    """A number from 0 for each region, every one in one piece.

    Source: Felzenszwalb and Huttenlocher 2004, Efficient graph-based image segmentation.
    """
    from skimage.segmentation import felzenszwalb

    share = working_share(lab.shape[0] * lab.shape[1])
    least = round(LEAST_AREA * share)
    colors = lab / np.float64(LAB_STEPS)
    labels = felzenszwalb(colors, scale=SCALE * share, sigma=SIGMA, min_size=least)
    return np.asarray(labels, np.int64)


def enlarged(labels: Int64[np.ndarray, "h w"], height: int, width: int) -> Int64[np.ndarray, "h2 w2"]:
    """Each pixel gets the label of the working image where its centre lies."""
    if labels.shape == (height, width):
        return labels
    rows = (2 * np.arange(height) + 1) * labels.shape[0] // (2 * height)
    columns = (2 * np.arange(width) + 1) * labels.shape[1] // (2 * width)
    return np.asarray(labels[rows[:, None], columns], np.int64)
