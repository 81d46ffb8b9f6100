"""Thresholds per query, found in the scores alone: columns beside the fixed and the tuned one."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float32

from ..query.thresholds import CUT, default_threshold, mixture_threshold, otsu_threshold
from .predictions import AUTOMATIC, Chooser
from .scorers import Scorer

Scores = Float32[np.ndarray, " N"]


def automatic_choosers(scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
    """By column, a function from scores to a threshold and what it does in words."""
    least = scorer.least
    how = "from" if least is None else f"the encoder's {least:g} or {CUT:g} of the peak of"
    return {
        AUTOMATIC: (_of_known(lambda known: default_threshold(known, least)), f"per query, {how} its scores"),
        "otsu": (_of_known(otsu_threshold), "per query, Otsu's split of its scores"),
        "mixture": (_of_known(mixture_threshold), "per query, two Gaussians fitted to its scores"),
    }


def _of_known(choose: Callable[[Scores], float]) -> Chooser:
    """Gaussians without a feature have no say; without any, nothing is selected."""

    def chosen(scores: Scores) -> float:
        known = scores[np.isfinite(scores)]
        return choose(known) if len(known) else float("inf")

    return chosen
