"""Thresholds per query, found in the scores alone: columns beside the fixed and the tuned one."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float32, Float64

from ..errors import InputError
from ..search import ABSENT
from ..thresholds import automatic_threshold, mixture_threshold, otsu_threshold, rise
from .predictions import Chooser
from .scorers import Scorer

Scores = Float32[np.ndarray, " N"]


def automatic_choosers(scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
    """By column, a function from scores to a threshold and what it does in words."""
    rises = _absent_rises(scorer)
    how = f"per query, from its scores and those of {len(rises)} words that nothing answers"
    return {
        "automatic": (_of_known(lambda known: automatic_threshold(known, rises)), how),
        "otsu": (_of_known(otsu_threshold), "per query, Otsu's split of its scores"),
        "mixture": (_of_known(mixture_threshold), "per query, two Gaussians fitted to its scores"),
    }


def _of_known(choose: Callable[[Scores], float]) -> Chooser:
    """Gaussians without a feature have no say; without any, nothing is selected."""

    def chosen(scores: Scores) -> float:
        known = scores[np.isfinite(scores)]
        return choose(known) if len(known) else float("inf")

    return chosen


def _absent_rises(scorer: Scorer) -> Float64[np.ndarray, " k"]:
    """Of the words that the encoder knows."""
    rises = []
    for text in ABSENT:
        try:
            scores = scorer.scores(text)
        except InputError:  # an encoder of few words
            continue
        known = scores[np.isfinite(scores)]
        if len(known):
            rises.append(rise(known))
    return np.array(rises, np.float64)
