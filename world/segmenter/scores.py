"""How well masks cover true things."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from drsplat.base.arrays import IndexRows

LEAST_PIXELS = 200  # of a thing in a photo, below which it does not count


@dataclass(frozen=True, eq=False)
class Score:
    """Of one photo. best: IoU of the best mask of each visible thing. area: its pixels. masks: how many.

    purity: share of pixels that lie in a mask whose main thing they show.
    """

    best: Float64[np.ndarray, " k"]
    area: Int64[np.ndarray, " k"]
    is_object: Bool[np.ndarray, " k"]
    masks: int
    purity: float


def shared_pixels(labels: Int64[np.ndarray, "*p"], truth: Int64[np.ndarray, "*p"], things: int) -> IndexRows:
    """Pixels of each label that show each thing."""
    count = int(labels.max()) + 1
    return np.bincount(labels.ravel() * things + truth.ravel(), minlength=count * things).reshape(count, things)


def score(shared: IndexRows, is_object: Bool[np.ndarray, " k"]) -> Score:
    shared = shared[shared.any(1)]
    area = shared.sum(0)
    iou = shared / np.maximum(shared.sum(1)[:, None] + area - shared, 1)
    seen = np.flatnonzero((area >= LEAST_PIXELS) & (np.arange(len(area)) > 0))
    purity = float(shared.max(1).sum() / shared.sum())
    return Score(iou.max(0)[seen], area[seen], is_object[seen], len(shared), purity)
