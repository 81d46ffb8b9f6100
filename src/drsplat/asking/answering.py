"""From a field and a question to scores and a threshold."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from ..crops import crop
from ..encoders import Encoder, ImageEncoder
from ..errors import InputError
from ..field import LanguageField, Negatives
from ..formats.vocabulary import VocabularyEncoder
from ..search import (
    ABSENT,
    CHUNK,
    LOWEST,
    NEGATIVES,
    embed_query,
    null_rises,
    relevancy_from_scores,
    rival_scores,
    split_negation,
    text_negatives,
    without,
)
from ..tasks import select
from ..thresholds import automatic_threshold, share_threshold, threshold_above
from .defaults import (
    AUTO,
    COSINE_THRESHOLD,
    DEFAULT,
    ENCODER,
    GIVEN,
    RELEVANCY_THRESHOLD,
    SHARE,
)
from .questions import Question

_Default = tuple[float | str, str]


@dataclass(frozen=True, eq=False)
class Asked:
    """query: its unit vector. values: per row of the field what is compared with the threshold.

    measure: "cosine" or "relevancy". rule: who chose the threshold: given, top share, auto, encoder or
    default.
    """

    field: LanguageField
    query: Float32[np.ndarray, " D"]
    values: Float32[np.ndarray, " r"]
    measure: str
    threshold: float
    rule: str

    @property
    def dense(self) -> Float32[np.ndarray, " n"]:
        """Values per Gaussian of the scene; the lowest where there is no feature."""
        return self.field.dense(self.values, fill=0.0 if self.measure == "relevancy" else -1.0)

    @property
    def gaussian_ids(self) -> Int64[np.ndarray, " m"]:
        """Of the Gaussians above the threshold, ascending."""
        return select(self.field, self.values, self.threshold)


@dataclass(frozen=True, eq=False)
class Background:
    """A field, who embeds its queries, and what questions are compared with, each made once when needed.

    source: makes the encoder; raises where there is none. Safe for several threads.
    """

    field: LanguageField
    source: Callable[[], Encoder]
    threads: int = 0

    @cached_property
    def encoder(self) -> Encoder:
        return self.source()

    @property
    def own_threshold(self) -> float | None:
        """The built-in encoders' cosines mean something."""
        return getattr(self.encoder, "threshold", None)

    @cached_property
    def null_rises(self) -> Float64[np.ndarray, " k"] | None:
        """How high words rise that are not in the scene; None where the encoder knows no such words."""
        for texts in (ABSENT, NEGATIVES):
            try:
                return null_rises(self.field, self.encoder, texts, threads=self.threads)
            except InputError:
                continue
        return None

    @cached_property
    def negatives(self) -> Negatives:
        """Those stored in the field, else LERF's."""
        if self.field.negatives is not None:
            return self.field.negatives
        return text_negatives(self.field, self.encoder, NEGATIVES, threads=self.threads)


@dataclass(frozen=True, eq=False)
class Asking:
    """How one question, or several texts alike, are answered.

    Words of a loaded encoder are measured by relevancy: CLIP's cosines of words with photos are seldom
    above 0.3, fit or not, and no threshold suits all of them. The automatic threshold is of cosines.
    """

    background: Background
    question: Question

    def about(self, text: str) -> Asked:
        """To a text; "mug, not red" leaves out what "red mug" fits as well.

        Raises: InputError: the encoder does not know the words. MismatchError: another encoder.
        """
        return next(iter(self.about_each([text])))

    def about_each(self, texts: Sequence[str]) -> Iterator[Asked]:
        """To each of several texts, scored several at a time."""
        field, encoder = self._field, self.background.encoder
        for begin in range(0, len(texts), CHUNK):
            split = [split_negation(text) for text in texts[begin : begin + CHUNK]]
            queries = [embed_query(encoder, field, wanted) for wanted, _ in split]
            scores = field.scores(np.stack(queries), threads=self.background.threads)
            for (wanted, unwanted), query, own in zip(split, queries, scores, strict=True):
                answer = self._measured(query, own, self._word_default, words=True)
                yield self._without(answer, own, wanted, (*unwanted, *self.question.unwanted))

    def like_image(self, picture: UInt8[np.ndarray, "_ _ 3"]) -> Asked:
        """To a picture of a thing.

        Raises: InputError: an encoder of words only. MismatchError: another encoder.
        """
        encoder = self.background.encoder
        query = embedded_image(encoder, picture)
        return self._of(query, self._word_default)

    def like(self, vector: Float32[np.ndarray, " D"]) -> Asked:
        """To a vector of the encoder's space."""
        return self._of(vector, (COSINE_THRESHOLD, DEFAULT))

    def like_feature(self, feature: Float32[np.ndarray, " D"]) -> Asked:
        """To a feature of the field itself: of an encoder, all features of a scene are alike."""
        return self._of(feature, (AUTO, AUTO))

    @property
    def _field(self) -> LanguageField:
        return self.background.field

    @property
    def _word_default(self) -> _Default:
        own = self.background.own_threshold
        return (COSINE_THRESHOLD, DEFAULT) if own is None else (own, ENCODER)

    def _without(
        self,
        answer: Asked,
        scores: Float32[np.ndarray, " r"],
        wanted: str,
        unwanted: tuple[str, ...],
    ) -> Asked:
        if not unwanted:
            return answer
        background = self.background
        rivals = rival_scores(
            self._field, background.encoder, wanted, unwanted, threads=background.threads
        )
        values = answer.values.copy()
        values[without(scores, rivals) == LOWEST] = LOWEST if answer.measure == "cosine" else 0.0
        return replace(answer, values=values)

    def _of(self, query: Float32[np.ndarray, " D"], default: _Default) -> Asked:
        scores = self._field.scores(query, threads=self.background.threads)
        return self._measured(query, scores, default)

    def _measured(
        self,
        query: Float32[np.ndarray, " D"],
        scores: Float32[np.ndarray, " r"],
        default: _Default,
        *,
        words: bool = False,
    ) -> Asked:
        ask = self.question
        uncertain = words and self._is_uncertain
        if ask.threshold == AUTO or not (ask.measures_relevancy or uncertain):
            cut = self._threshold(scores, default, words)
            return Asked(self._field, query, scores, "cosine", *cut)
        values = relevancy_from_scores(scores, self._negatives.maxima)
        cut = self._threshold(values, (RELEVANCY_THRESHOLD, DEFAULT), words)
        return Asked(self._field, query, values, "relevancy", *cut)

    @property
    def _is_uncertain(self) -> bool:
        """Of a model's words no cosine is known to be high enough."""
        background = self.background
        vocabulary = isinstance(background.encoder, VocabularyEncoder)
        return background.own_threshold is None and not vocabulary

    def _threshold(
        self, values: Float32[np.ndarray, " r"], default: _Default, words: bool
    ) -> tuple[float, str]:
        ask, background = self.question, self.background
        if ask.top_share is not None:
            return share_threshold(values, ask.top_share), SHARE
        cut, rule = default if ask.threshold is None else (ask.threshold, GIVEN)
        if cut == AUTO and words and background.own_threshold is not None:
            cut, rule = background.own_threshold, ENCODER  # knows what fits without absent words
        if cut == AUTO:
            return automatic_threshold(values, background.null_rises if words else None), AUTO
        return threshold_above(values, float(cut)) if rule == ENCODER else float(cut), rule

    @cached_property
    def _negatives(self) -> Negatives:
        """Those given, else those of the background."""
        field, given = self._field, self.question.negatives
        threads = self.background.threads
        if given is None:
            if (
                field.negatives is None
                and self.question.text is None
                and self.question.image is None
            ):
                raise InputError(
                    "relevancy compares the query with negatives and this field has none stored: give them"
                )
            return self.background.negatives
        if isinstance(given, tuple):
            return text_negatives(field, self.background.encoder, given, threads=threads)
        return field.score_negatives(given, threads=threads)


def embedded_image(
    encoder: Encoder, picture: UInt8[np.ndarray, "h w 3"]
) -> Float32[np.ndarray, " D"]:
    """A picture of a thing as the masks were: padded with black to a square.

    Raises: InputError: an encoder of words only.
    """
    if not isinstance(encoder, ImageEncoder):
        raise InputError(
            f"{encoder.identity.name} sees no images: pass encoder=NAME, the model that embedded the masks"
        )
    height, width = picture.shape[:2]
    square = crop(picture, np.ones((height, width), bool), (0, 0, width, height))
    vector: np.ndarray = encoder.encode_images([square])[0]
    return vector
