"""Ask a field alone, without a scene: `drsplat.query`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Int64

from ..encoders import Encoder
from ..field import LanguageField
from ..search import NEGATIVES, relevancy_from_scores, text_negatives
from .answering import Asked, Asking, Background
from .questions import Question


@dataclass(frozen=True, eq=False)
class Answer:
    """What a field says of a text. `select`, `locate` and `segment` take it as it is.

    asked: values per row of the field, the threshold that they are compared with, and who chose it.
    scores: cosines, one per row.
    """

    asked: Asked
    scores: Float32[np.ndarray, " r"]
    _maxima: Callable[[], Float32[np.ndarray, " r"]]

    @property
    def values(self) -> Float32[np.ndarray, " r"]:
        """What is compared with the threshold: cosines or, of CLIP-like encoders, how much better it fits."""
        return self.asked.values

    @property
    def threshold(self) -> float:
        return self.asked.threshold

    @property
    def gaussian_ids(self) -> Int64[np.ndarray, " m"]:
        """Of the Gaussians above the threshold, ascending."""
        return self.asked.gaussian_ids

    @cached_property
    def relevancy(self) -> Float32[np.ndarray, " r"]:
        """LERF's, in (0, 1): 0.5 where the query fits no better than a negative.

        Raises: InputError: the encoder does not know the negatives.
        """
        return relevancy_from_scores(self.scores, self._maxima())


def query(
    field: LanguageField,
    encoder: Encoder,
    text: str,
    negatives: Sequence[str] | None = None,
    *,
    threads: int = 0,
) -> Answer:
    """Ask for a text as `drsplat select` does: the same values, the same threshold.

    "mug, not red": what "red mug" fits as well or better is left out. negatives: measure LERF's relevancy
    against these texts instead; None also stands for LERF's own where an answer's `relevancy` is read.

    Raises: MismatchError: the field was written with another encoder. InputError: words that the encoder
    does not know, or no negatives.
    Source: Dr. Splat Sec. A "Inference stage"; Kerr et al. 2023 (LERF) for relevancy.
    """
    against = tuple(NEGATIVES if negatives is None else negatives)

    def maxima() -> Float32[np.ndarray, " r"]:
        return text_negatives(field, encoder, against, threads=threads).maxima

    background = Background(field, lambda: encoder, threads)
    given = None if negatives is None else against
    asked = Asking(background, Question(text=text, negatives=given)).about(text)
    return Answer(asked, asked.scores, maxima)
