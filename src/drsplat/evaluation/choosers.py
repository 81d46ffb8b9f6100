"""A threshold per query, found in the scores alone: a column beside the fixed and the tuned one."""

import numpy as np

from ..arrays import Float32
from ..query.thresholds import CUT, default_threshold
from .predictions import AUTOMATIC, Chooser
from .scorers import Scorer


def automatic_choosers(scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
    """By column, a function from scores to a threshold and what it does in words.

    Gaussians without a feature have no say; without any, nothing is selected.
    """
    least = scorer.least
    how = "from" if least is None else f"the encoder's {least:g} or {CUT:g} of the peak of"

    def chosen(scores: Float32[np.ndarray, " N"]) -> float:
        known = scores[np.isfinite(scores)]
        return default_threshold(known, least) if len(known) else float("inf")

    return {AUTOMATIC: (chosen, f"per query, {how} its scores")}
