"""Thresholds of a query's scores, judged by the scores themselves: pure functions of arrays.

Selected is what lies *above* a threshold. Where nothing stands out, the threshold is the highest score.
All follow the scores when these are shifted or scaled, and none depends on their order.
"""

import numpy as np

from ..base.arrays import Float
from ..errors import InputError

PEAK_ROWS = 40  # rows: a thing of fewer is a speck
CUT_SHARE = 0.6  # of the way to the peak: from the median, or from 0

Scores = Float[np.ndarray, " r"]


def peak_score(scores: Scores, peak: int = PEAK_ROWS) -> float:
    """Return the `peak`-th highest score, or the lowest of fewer: as many rows as make a thing reach it.

    Raises: InputError: no scores, or some that are not finite.
    """
    _check(scores)
    return _largest(scores, min(peak, len(scores)))


def automatic_threshold(scores: Scores, cut: float = CUT_SHARE, *, peak: int = PEAK_ROWS) -> float:
    """Return `cut` of the way from the median to the peak, the highest score where the peak is no higher than it.

    Raises: InputError: no scores, or some that are not finite.
    """
    _check(scores)
    middle, height = _largest(scores, (len(scores) + 1) // 2), peak_score(scores, peak)
    return float(middle + cut * (height - middle)) if height > middle else float(scores.max())


def default_threshold(cosines: Scores, least: float | None, cut: float = CUT_SHARE) -> float:
    """Return a threshold of cosines: by `least`, the encoder's own threshold, or, without one, automatic."""
    return automatic_threshold(cosines, cut) if least is None else threshold_above(cosines, least, cut)


def threshold_above(scores: Scores, least: float, cut: float = CUT_SHARE, *, peak: int = PEAK_ROWS) -> float:
    """Return `least`, an encoder's own threshold, or `cut` of the peak where that is higher.

    For scores of which 0 means "as well as not": what answers half of a query ("red", of "red mug") is left out
    where something answers all of it. No scores: `least`.
    """
    return max(least, cut * peak_score(scores, peak)) if len(scores) else least


def clear_threshold(scores: Scores, least: float, clear: float, *, peak: int = PEAK_ROWS) -> float:
    """Return `least` where the `peak`-th highest score stands above `clear`, else the highest: nothing is found.

    No scores: `least`.
    """
    if not len(scores):
        return least
    return least if peak_score(scores, peak) > clear else float(scores.max())


def share_threshold(scores: Scores, share: float) -> float:
    """Return the threshold above which this share of the rows lies, rounded; fewer where scores are equal.

    Raises: InputError: a share outside of [0, 1], or as `peak_score`.
    """
    if not 0 <= share <= 1:
        raise InputError(f"a share of the Gaussians lies between 0 and 1, got {share}")
    _check(scores)
    count = round(share * len(scores))
    if count == len(scores):
        return float(np.nextafter(scores.min(), scores.dtype.type(-np.inf)))
    return _largest(scores, count + 1)


def _check(scores: Scores) -> None:
    if not len(scores) or not np.isfinite(scores).all():
        raise InputError(f"a threshold needs one or more finite scores, got {len(scores)} rows")


def _largest(scores: Scores, rank: int) -> float:
    """Return the `rank`-th largest score, counted from 1."""
    at = len(scores) - rank
    return float(np.partition(scores, at)[at])
