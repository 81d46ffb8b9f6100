"""Thresholds per query, from the scores alone: a column beside the fixed and the tuned one."""

import numpy as np

from ..base.arrays import Float32
from ..query.thresholds import CUT_SHARE, default_threshold
from .predictions import AUTOMATIC, Chooser
from .scorers import Scorer


def automatic_choosers(scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
    """Return, by column, a function from scores to a threshold, and its description.

    Gaussians without a feature do not count; without any feature, nothing is selected.
    """
    least = scorer.least
    how = "from" if least is None else f"the encoder's {least:g} or {CUT_SHARE:g} of the peak of"

    def chosen(scores: Float32[np.ndarray, " N"]) -> float:
        finite = scores[np.isfinite(scores)]
        return default_threshold(finite, least) if len(finite) else float("inf")

    return {AUTOMATIC: (chosen, f"per query, {how} its scores")}
