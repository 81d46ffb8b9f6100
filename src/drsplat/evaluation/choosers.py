"""Thresholds per query, found in the scores alone: columns beside the fixed and the tuned one."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float32, Float64

from ..errors import InputError
from ..search import ABSENT
from ..thresholds import (
    CUT,
    automatic_threshold,
    mixture_threshold,
    otsu_threshold,
    rise,
    threshold_above,
)
from .predictions import Chooser
from .scorers import Scorer

AUTOMATIC = "automatic"

Scores = Float32[np.ndarray, " N"]


def automatic_choosers(scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
    """By column, a function from scores to a threshold and what it does in words."""
    return {
        AUTOMATIC: _automatic(scorer),
        "otsu": (_of_known(otsu_threshold), "per query, Otsu's split of its scores"),
        "mixture": (_of_known(mixture_threshold), "per query, two Gaussians fitted to its scores"),
    }


def _automatic(scorer: Scorer) -> tuple[Chooser, str]:
    """As `drsplat select` chooses it: of the encoder's own threshold, or of words of what is not there."""
    least = scorer.least
    if least is not None:
        how = f"per query, the encoder's {least:g} or {CUT:g} of the peak of its scores"
        return _of_known(lambda known: threshold_above(known, least)), how
    rises = _absent_rises(scorer)
    how = f"per query, from its scores and those of {len(rises)} words that nothing answers"
    return _of_known(lambda known: automatic_threshold(known, rises)), how


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
