"""From a field and a query on the command line to scores and a threshold; for all verbs that search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from .query_inputs import Click, embedded_image, read_vector, read_vectors

if TYPE_CHECKING:
    import numpy as np

    from ..encoders import Encoder
    from ..field import LanguageField, Negatives

RELEVANCY_THRESHOLD, COSINE_THRESHOLD = 0.5, 0.5
MIN_GAUSSIANS = 40
AUTO, ENCODER = "auto", "encoder"


@dataclass(frozen=True)
class Ask:
    """The query as given: a text, an image, a file with a vector or a click; who embeds it; how to measure.

    unwanted: what the text does not mean. threshold: a number, AUTO or None, the default; top_share
    takes its place. Defaults are those of the options.
    """

    text: str | None = None
    vector: str | None = None
    image: str | None = None
    click: Click | None = None
    unwanted: tuple[str, ...] = ()
    vocabulary: str | None = None
    encoder: str | None = None
    device: str = "auto"
    relevancy: bool = False
    negatives: str | None = None
    threshold: float | str | None = None
    top_share: float | None = None


@dataclass(frozen=True, eq=False)
class Asked:
    """query: its unit vector. values: per row of the field what is compared with the threshold.

    rule: who chose the threshold: given, top share, auto, encoder or default.
    """

    field: LanguageField
    query: np.ndarray
    values: np.ndarray
    measure: str
    threshold: float
    rule: str

    @property
    def dense(self) -> np.ndarray:
        """Values per Gaussian of the scene; the lowest where there is no feature."""
        return self.field.dense(self.values, fill=0.0 if self.measure == "relevancy" else -1.0)


def asked(field: LanguageField, ask: Ask, threads: int = 0) -> Asked:
    """Scores of the field for a query, and the threshold.

    Words of a loaded encoder are measured by relevancy: CLIP's cosines of words with photos are seldom
    above 0.3, fit or not, and no threshold suits all of them. The automatic threshold is of cosines.

    Raises: InputError: not one of text, image, vector and click; no encoder for it; options that
    exclude each other. MismatchError: another encoder.
    """
    return Asking(field, ask, threads).answer()


@dataclass(frozen=True, eq=False)
class Asking:
    """A field and how it is asked; what several texts need is made once."""

    field: LanguageField
    ask: Ask
    threads: int = 0

    def __post_init__(self) -> None:
        from ..errors import InputError

        if self.ask.threshold == AUTO and (self.ask.relevancy or self.ask.negatives):
            raise InputError(
                "--threshold auto cuts cosines: drop --relevancy and --negatives, or give a number"
            )

    def answer(self) -> Asked:
        """To the one thing asked."""
        from ..errors import InputError
        from ..search import feature_at

        ask = self.ask
        if sum(given is not None for given in (ask.text, ask.image, ask.vector, ask.click)) != 1:
            raise InputError(
                "give one of these: a text, --image PICTURE, --vector FILE.npy or --click VIEW:X,Y"
            )
        if ask.text is not None:
            return self.about(ask.text)
        if ask.unwanted:
            raise InputError("--not goes with a query in words")
        if ask.vector is not None:
            return self._of(read_vector(ask.vector))
        if ask.click is not None:
            click = ask.click
            return self._of(feature_at(self.field, click.gaussians, click.view, click.xy))
        return self._of(embedded_image(self.encoder, str(ask.image)), own=self.own_threshold)

    def about(self, text: str) -> Asked:
        """To a text; "mug, not red" leaves out what "red mug" fits as well."""
        return next(iter(self.about_each([text])))

    def about_each(self, texts: Sequence[str]) -> Iterator[Asked]:
        """To each of several texts, scored several at a time."""
        import numpy as np

        from ..search import CHUNK, embed_query, split_negation

        for begin in range(0, len(texts), CHUNK):
            split = [split_negation(text) for text in texts[begin : begin + CHUNK]]
            queries = [embed_query(self.encoder, self.field, wanted) for wanted, _ in split]
            scores = self.field.scores(np.stack(queries), threads=self.threads)
            for (wanted, unwanted), query, own in zip(split, queries, scores, strict=True):
                answer = self._measured(query, own, own=self.own_threshold, words=True)
                yield self._without(answer, own, wanted, (*unwanted, *self.ask.unwanted))

    def _without(
        self, answer: Asked, scores: np.ndarray, wanted: str, unwanted: tuple[str, ...]
    ) -> Asked:
        from ..search import LOWEST, rival_scores, without

        if not unwanted:
            return answer
        rivals = rival_scores(self.field, self.encoder, wanted, unwanted, threads=self.threads)
        values = answer.values.copy()
        values[without(scores, rivals) == LOWEST] = LOWEST if answer.measure == "cosine" else 0.0
        return replace(answer, values=values)

    @cached_property
    def encoder(self) -> Encoder:
        from .options import encoder_for

        return encoder_for(self.field, self.ask.vocabulary, self.ask.encoder, self.ask.device)

    @property
    def own_threshold(self) -> float | None:
        """The built-in encoders' cosines mean something."""
        return getattr(self.encoder, "threshold", None)

    def _of(self, query: np.ndarray, *, own: float | None = None) -> Asked:
        return self._measured(query, self.field.scores(query, threads=self.threads), own=own)

    def _measured(
        self,
        query: np.ndarray,
        scores: np.ndarray,
        *,
        own: float | None = None,
        words: bool = False,
    ) -> Asked:
        from ..search import relevancy_from_scores

        ask, uncertain = self.ask, words and self.ask.encoder is not None and own is None
        if ask.threshold == AUTO or not (ask.relevancy or ask.negatives or uncertain):
            cut = self._threshold(scores, self._cosine_default(own), words)
            return Asked(self.field, query, scores, "cosine", *cut)
        values = relevancy_from_scores(scores, self._negatives.maxima)
        cut = self._threshold(values, (RELEVANCY_THRESHOLD, "default"), words)
        return Asked(self.field, query, values, "relevancy", *cut)

    def _cosine_default(self, own: float | None) -> tuple[float | str, str]:
        if self.ask.click is not None:
            return AUTO, AUTO  # of an encoder, all features of a scene are alike
        return (COSINE_THRESHOLD, "default") if own is None else (own, ENCODER)

    def _threshold(
        self, values: np.ndarray, default: tuple[float | str, str], words: bool
    ) -> tuple[float, str]:
        from ..thresholds import automatic_threshold, share_threshold, threshold_above

        ask = self.ask
        if ask.top_share is not None:
            return share_threshold(values, ask.top_share), "top share"
        cut, rule = default if ask.threshold is None else (ask.threshold, "given")
        if cut == AUTO and words and self.own_threshold is not None:
            cut, rule = self.own_threshold, ENCODER  # knows what fits: no absent words are needed
        if cut == AUTO:
            return automatic_threshold(values, self._null_rises if words else None), AUTO
        return threshold_above(values, float(cut)) if rule == ENCODER else float(cut), rule

    @cached_property
    def _null_rises(self) -> np.ndarray | None:
        """How high words rise that are not in the scene; None where the encoder knows no such words."""
        from ..errors import InputError
        from ..search import ABSENT, NEGATIVES, null_rises

        for texts in (ABSENT, NEGATIVES):
            try:
                return null_rises(self.field, self.encoder, texts, threads=self.threads)
            except InputError:
                continue
        return None

    @cached_property
    def _negatives(self) -> Negatives:
        """Those given, else those stored in the field, else LERF's."""
        from ..errors import InputError
        from ..search import NEGATIVES, text_negatives

        field, given = self.field, self.ask.negatives
        if given is not None and given.endswith(".npy"):
            return field.score_negatives(read_vectors(given), threads=self.threads)
        if given is None and field.negatives is not None:
            return field.negatives
        if given is None and (self.ask.vector or self.ask.click):
            raise InputError(
                "relevancy compares the query with negatives and this field has none stored: pass --negatives FILE.npy"
            )
        words = NEGATIVES if given is None else [word.strip() for word in given.split(",")]
        return text_negatives(field, self.encoder, words, threads=self.threads)
