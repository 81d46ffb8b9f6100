"""Fixed thresholds and thresholds tuned on the test: both in every table, and never mixed."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..base.arrays import Bool, Float32, Float64
from .predictions import is_sweep

MIN_MIOU_GAIN = 1e-12


def best_sweep(means: Mapping[str, float]) -> str | None:
    """Return the sweep's column with the best mean over the scenes; the lowest threshold of equal ones.

    Source: Dr. Splat Sec. B: "searching the thresholds that show the best mIoU on the scenes used
    for evaluation". One for all scenes and queries.
    """
    best: str | None = None
    for column in sorted(column for column in means if is_sweep(column)):
        if best is None or means[column] > means[best] + MIN_MIOU_GAIN:
            best = column
    return best


def sweep_weighted_ious(
    scores: Float32[np.ndarray, " n"],
    truth: Bool[np.ndarray, " n"],
    weights: Float64[np.ndarray, " n"],
    thresholds: Sequence[float],
) -> Float64[np.ndarray, " t"]:
    """Return Eq. 3's IoU of {score > t} for each threshold t, in one pass over the Gaussians.

    A score of NaN is above no threshold.

    >>> sweep_weighted_ious(
    ...     np.array([0.9, 0.6, 0.2, np.nan], np.float32), np.array([True, False, True, True]),
    ...     np.array([1.0, 2.0, 1.0, 4.0]), [0.5, 0.7])
    array([0.125     , 0.16666667])
    """
    edges = np.sort(np.asarray(thresholds, np.float32))
    above = np.searchsorted(edges, np.nan_to_num(scores, nan=-np.inf), side="left")
    size = len(edges) + 1
    both = np.bincount(above[truth], weights[truth], size).astype(float)
    only = np.bincount(above[~truth], weights[~truth], size).astype(float)
    selected_true = np.cumsum(both[::-1])[::-1][1:]  # above edge k: passed more than k edges
    selected_other = np.cumsum(only[::-1])[::-1][1:]
    union = both.sum() + selected_other
    ious = np.divide(selected_true, union, out=np.zeros(len(edges)), where=union > 0)
    return np.asarray(ious[np.searchsorted(edges, np.asarray(thresholds, np.float32))])
