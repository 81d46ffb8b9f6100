"""Metrics of the protocols: pure functions of arrays.

Labels are 1 to C; 0 is "none" in a prediction and "not counted" in the truth.
"""

from collections.abc import Sequence

import numpy as np

from ..base.arrays import Bool, Float64, Integer, Real

Labels = Integer[np.ndarray, " n"]
Numbers = Sequence[float | int] | Real[np.ndarray, " n"]
NUM_RESAMPLINGS = 2000


def mask_iou(predicted: Bool[np.ndarray, "*n"], truth: Bool[np.ndarray, "*n"]) -> float:
    """Return the intersection over union; 0 where both masks are empty.

    >>> mask_iou(np.array([True, True, False, False]), np.array([False, True, True, False]))
    0.3333333333333333
    >>> mask_iou(np.zeros(3, bool), np.zeros(3, bool))
    0.0

    Source: OpenGaussian's evaluation of 3D object selection.
    """
    union = int((predicted | truth).sum())
    return int((predicted & truth).sum()) / union if union else 0.0


def share_above(ious: Numbers, threshold: float) -> float:
    """Return Acc@threshold: the share of IoUs that are strictly greater; NaN for an empty list.

    >>> share_above([0.2, 0.25, 0.26, 0.9], 0.25)
    0.5
    """
    return mean([float(iou > threshold) for iou in ious])


def mean(values: Numbers) -> float:
    """Return the mean; NaN for an empty list, without a warning.

    >>> mean([0.0, 1.0]), mean([])
    (0.5, nan)
    """
    return float(np.mean(np.asarray(values, np.float64))) if len(values) else float("nan")


def scene_macro(by_scene: Sequence[Numbers]) -> float:
    """Return the mean over scenes of the mean within each, so that all scenes count alike.

    >>> scene_macro([[1.0], [0.0, 0.0, 0.5]])
    0.5833333333333334
    """
    return mean([mean(values) for values in by_scene])


def class_overlaps(
    predicted: Labels, truth: Labels, num_classes: int, weights: Real[np.ndarray, " n"] | None = None
) -> tuple[Float64[np.ndarray, " c"], Float64[np.ndarray, " c"], Float64[np.ndarray, " c"]]:
    """Return, per class, the weight of the intersection, of the prediction and of the truth.

    Rows without truth (0) are left out of all three.

    >>> class_overlaps(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 2)
    (array([1., 1.]), array([1., 2.]), array([2., 1.]))
    """
    counted = truth > 0
    predicted, truth = predicted[counted], truth[counted]
    mass = np.ones(len(truth)) if weights is None else weights[counted].astype(np.float64)
    parts = (
        np.bincount(labels[rows], mass[rows], num_classes + 1)[1 : num_classes + 1].astype(float)
        for labels, rows in ((truth, predicted == truth), (predicted, slice(None)), (truth, slice(None)))
    )
    both, of_prediction, of_truth = parts
    return both, of_prediction, of_truth


def class_ious(
    predicted: Labels, truth: Labels, num_classes: int, weights: Real[np.ndarray, " n"] | None = None
) -> Float64[np.ndarray, " c"]:
    """Return the IoU of each class (Eq. 3 with weights); NaN for classes that the truth lacks.

    >>> class_ious(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 3)
    array([0.5, 0.5, nan])
    >>> class_ious(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 3, np.array([3, 1, 1, 9]))
    array([0.75, 0.5 ,  nan])

    Source: Dr. Splat Eq. 3; with equal weights, OpenGaussian's evaluation on ScanNet.
    """
    both, of_prediction, of_truth = class_overlaps(predicted, truth, num_classes, weights)
    return _ratio(both, of_prediction + of_truth - both, of_truth > 0)


def class_accuracies(
    predicted: Labels, truth: Labels, num_classes: int, weights: Real[np.ndarray, " n"] | None = None
) -> Float64[np.ndarray, " c"]:
    """Return the share of each class that is predicted as it; NaN for classes that the truth lacks.

    >>> class_accuracies(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 3)
    array([0.5, 1. , nan])
    """
    both, _, of_truth = class_overlaps(predicted, truth, num_classes, weights)
    return _ratio(both, of_truth, of_truth > 0)


def mean_present(values: Float64[np.ndarray, " c"]) -> float:
    """Return the mean over the classes that are present (not NaN).

    >>> mean_present(np.array([0.5, np.nan, 1.0]))
    0.75
    """
    return mean(values[~np.isnan(values)])


def in_any_box(x: float | int, y: float | int, boxes: Sequence[Numbers]) -> bool:
    """Return whether a point lies in or on one of the boxes (x1, y1, x2, y2).

    >>> in_any_box(3, 4, [[0, 0, 1, 1], [3, 2, 5, 4]]), in_any_box(3, 4.5, [[3, 2, 5, 4]])
    (True, False)
    """
    return any(x1 <= x <= x2 and y1 <= y <= y2 for x1, y1, x2, y2 in boxes)


def pearson(a: Numbers, b: Numbers) -> float:
    """Return the correlation of two lists; NaN where one of them is constant.

    >>> round(pearson([1, 2, 3], [2, 4, 7]), 4), pearson([1, 2], [3, 3])
    (0.9934, nan)
    """
    x, y = (np.asarray(values, np.float64) - np.mean(values) for values in (a, b))
    scale = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / scale if scale > 0 else float("nan")


def spearman(a: Numbers, b: Numbers) -> float:
    """Return the correlation of the ranks; equal values share the mean of their ranks.

    >>> spearman([1, 2, 3, 4], [1, 8, 27, 64]), spearman([1, 2, 2], [1, 1, 3])
    (1.0, 0.5)
    """
    from scipy.stats import rankdata

    return pearson(rankdata(a), rankdata(b))


def mean_interval(values: Numbers, level: float = 0.95) -> tuple[float, float]:
    """Return a bootstrap interval of the mean over scenes: quantiles of means of resampled scenes.

    It is NaN for fewer than two: one scene says nothing about others.

    >>> mean_interval([0.5, 0.5, 0.5])
    (0.5, 0.5)
    """
    if len(values) < 2:
        return float("nan"), float("nan")
    drawn = np.random.default_rng(0).integers(0, len(values), (NUM_RESAMPLINGS, len(values)))
    means = np.asarray(values, np.float64)[drawn].mean(1)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _ratio(
    part: Float64[np.ndarray, " c"], whole: Float64[np.ndarray, " c"], present: Bool[np.ndarray, " c"]
) -> Float64[np.ndarray, " c"]:
    ratio: np.ndarray = np.divide(part, whole, out=np.full(len(part), np.nan), where=present)
    return ratio
