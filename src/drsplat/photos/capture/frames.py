"""Choice of the frames of a film that become photos: sharp ones, each after the picture has moved on.

Time plays no part: a camera that stands still gives one photo, one that turns quickly gives many.
"""

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Bool, Float64, Int64, UInt8

STEP_SHARE = 0.06  # of the picture's width, from one photo to the next
TARGET_PHOTOS_BOUNDS = (40, 1000)  # the step is made shorter or longer to reach this range
MIN_STEP_SHARE = 0.01
MAX_STILL_SHARE = 0.001  # of the width moved since the frame before: it shows the same picture again
MAX_BLURRED_SHARE = 0.6  # of the median sharpness of the frames around
NEIGHBOURHOOD_FRAMES = 15  # to either side
BLOCKS_ACROSS = 4


@dataclass(frozen=True, eq=False)
class Film:
    """Measurements of each frame. sharpness: see `photos.sharpness`. moved: shares of the width since the last."""

    sharpness: Float64[np.ndarray, " n"]
    moved: Float64[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Choice:
    """Choice of frames. frames: indices of the chosen ones. num_blurred, num_still: of unusable ones."""

    frames: Int64[np.ndarray, " k"]
    num_blurred: int
    num_still: int


def choose(film: Film) -> Choice:
    """Choose the sharpest frame of each step of the picture's movement; steps without a sharp frame give none."""
    path = np.cumsum(film.moved)
    blurred = are_blurred(film.sharpness)
    usable = np.flatnonzero(~blurred)
    if not len(usable):
        return Choice(usable, int(blurred.sum()), 0)
    fewest, most = TARGET_PHOTOS_BOUNDS
    step = float(np.clip(path[-1] / fewest, MIN_STEP_SHARE, max(STEP_SHARE, path[-1] / most)))
    steps = np.round(path[usable] / step).astype(np.int64)
    order = np.lexsort((usable, -film.sharpness[usable], steps))
    first = np.unique(steps[order], return_index=True)[1]
    still = int((film.moved[1:] < MAX_STILL_SHARE).sum())
    return Choice(np.sort(usable[order[first]]), int(blurred.sum()), still)


def are_blurred(sharpness: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return which frames are much less sharp than the frames around them."""
    from scipy.ndimage import median_filter

    return np.asarray(
        sharpness < MAX_BLURRED_SHARE * median_filter(sharpness, size=2 * NEIGHBOURHOOD_FRAMES + 1, mode="nearest")
    )


def movement(before: UInt8[np.ndarray, "h w"], now: UInt8[np.ndarray, "h w"]) -> float:
    """Return how far parts of a picture have moved, as the median share of its width.

    It is measured by blocks, because a camera that walks ahead or rolls moves them in different directions.
    """
    side = now.shape[1] // BLOCKS_ACROSS
    shifts = [
        shift_of(before[y : y + side, x : x + side], now[y : y + side, x : x + side])
        for y in range(0, now.shape[0] - side + 1, side)
        for x in range(0, now.shape[1] - side + 1, side)
    ]
    return float(np.median(shifts)) / now.shape[1] if shifts else 0.0


def shift_of(before: UInt8[np.ndarray, "h w"], now: UInt8[np.ndarray, "h w"]) -> float:
    """Return the length of a block's shift in pixels, by phase correlation; 0 if it has no texture.

    Source: Kuglin and Hines, The phase correlation image alignment method, 1975.
    """
    height, width = now.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    spectrum, shifted = (np.fft.rfft2((block - block.mean()) * window) for block in (before, now))
    cross = spectrum * shifted.conj()
    strength = np.abs(cross)
    if not strength.max() > 1e-6:
        return 0.0
    peak = np.fft.irfft2(cross / np.maximum(strength, 1e-3 * strength.max()), s=(height, width)).argmax()
    down, across = divmod(int(peak), width)
    down, across = min(down, height - down), min(across, width - across)
    return float(np.hypot(down, across))
