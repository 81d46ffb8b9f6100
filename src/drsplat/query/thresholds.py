"""Where to cut the scores of a query, judged by the scores themselves: pure functions of arrays.

Selected is what lies *above* a threshold. Where nothing stands out, the threshold is the highest score.
All follow the scores when these are shifted or scaled, and none depends on their order.
"""

import numpy as np
from jaxtyping import Float, Float64

from ..errors import InputError

PEAK = 40  # rows: a thing of fewer is a speck
CUT = 0.6  # of the way to the peak: from the median, or from 0
BINS, STEPS, SETTLED = 512, 200, 1e-4

Scores = Float[np.ndarray, " r"]


def peak_score(scores: Scores, peak: int = PEAK) -> float:
    """The `peak`-th highest, the lowest of fewer: what as many rows reach as make a thing.

    Raises: InputError: no scores, or some that are not finite.
    """
    _check(scores)
    return _largest(scores, min(peak, len(scores)))


def automatic_threshold(scores: Scores, *, peak: int = PEAK) -> float:
    """`CUT` of the way from the median to the peak, the highest score where the peak is no higher than the median.

    Raises: InputError: no scores, or some that are not finite.
    """
    middle, height = _median(scores), peak_score(scores, peak)
    return float(middle + CUT * (height - middle)) if height > middle else float(scores.max())


def default_threshold(cosines: Scores, least: float | None) -> float:
    """Where nothing but cosines is known: by `least`, the encoder's own threshold, or without one automatic."""
    return automatic_threshold(cosines) if least is None else threshold_above(cosines, least)


def threshold_above(scores: Scores, least: float, *, peak: int = PEAK) -> float:
    """`least`, an encoder's own threshold, or `CUT` of the peak where that is higher.

    For scores of which 0 means "as well as not": what answers half of a query ("red", of "red mug") is left out
    where something answers all of it. No scores: `least`.
    """
    return max(least, CUT * peak_score(scores, peak)) if len(scores) else least


def clear_threshold(scores: Scores, least: float, clear: float, *, peak: int = PEAK) -> float:
    """`least` where the `peak`-th highest score stands above `clear`, else the highest: nothing is found.

    No scores: `least`.
    """
    if not len(scores):
        return least
    return least if peak_score(scores, peak) > clear else float(scores.max())


def share_threshold(scores: Scores, share: float) -> float:
    """The threshold above which this share of the rows lies, rounded; fewer where scores are equal.

    Raises: InputError: a share outside of [0, 1], or as `peak_score`.
    """
    if not 0 <= share <= 1:
        raise InputError(f"a share of the Gaussians lies between 0 and 1, got {share}")
    _check(scores)
    count = round(share * len(scores))
    if count == len(scores):
        return float(np.nextafter(scores.min(), scores.dtype.type(-np.inf)))
    return _largest(scores, count + 1)


def otsu_threshold(scores: Scores) -> float:
    """The middle of the gap that splits the scores into the two groups of least variance within.

    Raises: InputError: as `peak_score`.
    Source: Otsu 1979, without a histogram.
    """
    _check(scores)
    ordered = np.sort(scores.astype(np.float64))
    centered = ordered - ordered.mean()
    below, total = np.arange(1, len(ordered)), np.cumsum(centered)[:-1]
    # of two groups of sizes n0, n1 and sums t, -t about the mean: n0 n1 (mean1 - mean0)^2 = n^2 t^2 / (n0 n1)
    between = total**2 / (below * (len(ordered) - below))
    between[np.diff(ordered) == 0] = -1
    if not (between > 0).any():
        return float(ordered[-1])
    best = int(between.argmax())
    return float((ordered[best] + ordered[best + 1]) / 2)


def mixture_threshold(scores: Scores) -> float:
    """Where the upper of two Gaussians fitted to the scores becomes the likelier one.

    Fitted by expectation maximisation to a histogram, from Otsu's split.

    Raises: InputError: as `peak_score`.
    """
    start = otsu_threshold(scores)
    low, high = float(scores.min()), float(scores.max())
    if not start < high:
        return high
    counts, edges = np.histogram(scores.astype(np.float64), BINS, (low, high))
    at, weight = (edges[1:] + edges[:-1]) / 2, counts / counts.sum()
    upper = (at > start).astype(np.float64)
    floor = ((high - low) / BINS) ** 2  # no component is narrower than a bin
    for _ in range(STEPS):
        parts = [_moments(at, weight * share, floor) for share in (1 - upper, upper)]
        if min(part[0] for part in parts) <= 0:
            return high
        before, upper = upper, _posterior(at, *parts)
        if np.abs(upper - before).max() < SETTLED:
            break
    likelier = np.flatnonzero((upper > 0.5) & (at > parts[0][1]))
    return float(edges[likelier[0]]) if len(likelier) else high


Component = tuple[float, float, float]  # weight, mean, variance


def _moments(at: Float64[np.ndarray, " b"], weight: Float64[np.ndarray, " b"], floor: float) -> Component:
    total = float(weight.sum())
    mean = float(weight @ at) / total if total > 0 else 0.0
    return total, mean, float(weight @ (at - mean) ** 2) / max(total, 1e-300) + floor


def _posterior(at: Float64[np.ndarray, " b"], lower: Component, upper: Component) -> Float64[np.ndarray, " b"]:
    logs = [
        np.log(weight / np.sqrt(variance)) - (at - mean) ** 2 / (2 * variance)
        for weight, mean, variance in (lower, upper)
    ]
    return np.asarray(1 / (1 + np.exp(np.clip(logs[0] - logs[1], -500, 500))))


def _check(scores: Scores) -> None:
    if not len(scores) or not np.isfinite(scores).all():
        raise InputError(f"a threshold needs one or more finite scores, got {len(scores)} rows")


def _largest(scores: Scores, rank: int) -> float:
    """The `rank`-th largest, counted from 1."""
    at = len(scores) - rank
    return float(np.partition(scores, at)[at])


def _median(scores: Scores) -> float:
    _check(scores)
    return _largest(scores, (len(scores) + 1) // 2)
