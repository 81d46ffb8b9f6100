"""All rules of measuring and cutting: a field and a query become values and a threshold."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ..base.arrays import Embedding, Embeddings, Flags, Numbers, OtherFlags, Pixels
from ..errors import InputError, MissingExtraError
from ..field import LanguageField, Negatives, relevancy_from_scores
from ..formats.vocabulary import VocabularyEncoder
from ..kernels.algebra import dense_rows
from ..photos.models.mini import MiniEncoder
from ..photos.models.mini.lexicon import swapped
from ..photos.models.word_list import list_vectors, listed_words, names_under, rival_vectors
from ..scene.encoders import Encoder, ImageEncoder
from ..scene.masks.crops import crop
from .answer import Answer
from .contrast import LIST_RELEVANCY, Contrast, certainty_of, contrast, contrast_of_kind, own_level
from .defaults import (
    AUTO,
    COSINE,
    DEFAULT,
    ENCODER,
    GIVEN,
    LIST,
    MAYBE,
    NOTHING,
    RELEVANCY,
    RELEVANCY_THRESHOLD,
    SHARE,
    SURE,
)
from .encoding import list_doubt
from .naming import doubt_of
from .query import Cut, Query
from .search import (
    NEGATIVES,
    QUERIES_AT_ONCE,
    UNSELECTED_COSINE,
    embed_query,
    rival_scores,
    split_negation,
    text_negatives,
    without,
)
from .thresholds import PEAK_ROWS, default_threshold, peak_score, share_threshold
from .wholes import by_object

MAYBE_LEAST_SHARE = 0.7  # of the least peak, for a maybe of an encoder that has one
WEAK_DOUBT = "only maybe: it fits less well than what is found here usually does"
SWAP_TOLERANCE = 0.02  # cosine by which what has another colour, or is another thing, may fit better
HALF_FIT_SHARE = 0.6  # of the 40th highest cosine; half, and some more

_Default = tuple[float | None, str]


@dataclass(frozen=True, eq=False)
class Background:
    """A field, who embeds its queries, and what queries are compared with, each made once when needed.

    source: makes the encoder; raises where there is none. Safe for several threads.
    """

    field: LanguageField
    source: Callable[[], Encoder]
    threads: int = 0

    @cached_property
    def encoder(self) -> Encoder:
        return self.source()

    @cached_property
    def plain(self) -> LanguageField:
        """The field without its objects."""
        return self.field.with_objects(None)

    @property
    def own_threshold(self) -> float | None:
        return own_threshold(self.encoder)

    @cached_property
    def list_doubt(self) -> str:
        """Reason why a vocabulary says little of what words do not mean; "" of a long one, and without one."""
        try:
            encoder = self.encoder
        except (InputError, MissingExtraError):  # nobody embeds words here
            return ""
        return list_doubt(encoder.texts, self.field) if isinstance(encoder, VocabularyEncoder) else ""

    @cached_property
    def kept_contrast(self) -> Contrast | None:
        """The list that the field keeps, scored: no encoder is needed for it."""
        kept = self.field.contrast
        return None if kept is None else contrast(self.field, kept.embeddings, threads=self.threads)

    @cached_property
    def contrast(self) -> Contrast | None:
        """A list of words, scored at each Gaussian; None where no list is known."""
        vectors = list_vectors(self.encoder)
        return contrast(self.field, vectors, threads=self.threads) if len(vectors) else None

    def contrast_for(self, text: str | None) -> Contrast | None:
        """Return what a text competes with: words of its own kind where the encoder says so, else a list of words."""
        if self.kept_contrast is not None:
            return self.kept_contrast
        rivals = rival_vectors(self.encoder, text)
        return self.contrast if rivals is None else self.contrast_of_kind(rivals)

    def contrast_of_kind(self, vectors: Embeddings) -> Contrast:
        return contrast_of_kind(self.field, vectors, threads=self.threads)

    @cached_property
    def least_peak(self) -> float:
        """Cosine that a thing's best rows exceed: the encoder's share of what the list reaches in this scene."""
        return -np.inf if self.kept_contrast is not None else least_peak(self.encoder, self.contrast)

    def least_peak_of(self, known: Contrast) -> float:
        """Return the same for what a query competes with: colours reach other cosines than nouns do."""
        if self.kept_contrast is not None or known is self.contrast:
            return self.least_peak
        return least_peak(self.encoder, known)

    def texts_of(self, known: Contrast) -> Sequence[str]:
        """Return the words of a contrast, none of those of one kind alone."""
        kept = self.field.contrast
        if known.of_kind:
            return ()
        return listed_words(self.encoder)[0] if kept is None else kept.texts

    def same_kind(self, known: Contrast, text: str | None) -> Flags | None:
        """Mark the words of a contrast that name what is of the kind of a text; None: there are none."""
        is_taught = np.isfinite(self.least_peak)  # an encoder of few words was taught what they stand for
        return None if text is None or is_taught else same_kind(self.texts_of(known), text)

    def by_object(self, field: LanguageField, values: Numbers) -> Numbers:
        """Return values per row of the field, with or without objects, as whole objects have them."""
        return by_object(field, values)

    @cached_property
    def negatives(self) -> Negatives:
        """Those stored in the field, else LERF's.

        Raises: InputError: there are none stored, and nobody to embed LERF's.
        """
        if self.field.negatives is not None:
            return self.field.negatives
        try:
            encoder = self.encoder
        except InputError as error:
            raise InputError(
                "relevancy compares the query with negatives and this field has none stored: pass "
                "negatives=WORDS or vectors"
            ) from error
        return text_negatives(self.field, encoder, NEGATIVES, threads=self.threads)


@dataclass(frozen=True, eq=False)
class Measuring:
    """How one query, or several texts alike, are measured and cut.

    Of CLIP-like encoders no cosine is known to be high enough, whoever embeds the words: these are measured
    by how much better they fit than a list of words. Vectors, pictures and clicks are cut automatically.
    exclude: words that rule out what fits them as well, with any text.
    """

    background: Background
    cut: Cut
    exclude: tuple[str, ...] = ()

    def of(self, query: Query) -> Answer:
        """Return the answer to a text, a picture or a vector. Raises: as of each of these."""
        if query.text is not None:
            return next(iter(self.of_texts([query.text])))
        if query.image is not None:
            return self.of_vector(embedded_image(self.background.encoder, query.image))
        assert query.vector is not None
        return self.of_vector(query.vector)

    def of_texts(self, texts: Sequence[str]) -> Iterator[Answer]:
        """Answer each of several texts, scored several at a time."""
        field, encoder = self._field, self.background.encoder
        for begin in range(0, len(texts), QUERIES_AT_ONCE):
            split = [split_negation(text) for text in texts[begin : begin + QUERIES_AT_ONCE]]
            queries = [embed_query(encoder, field, wanted) for wanted, _ in split]
            scores = field.scores(np.stack(queries), threads=self.background.threads)
            for (wanted, unwanted), query, own in zip(split, queries, scores, strict=True):
                answer = self._of_words(query, own, wanted)
                doubt = ". ".join(filter(None, (answer.doubt, doubt_of(encoder, field, wanted))))
                answer = replace(answer, doubt=doubt, list_doubt=self.background.list_doubt)
                yield self._without(answer, own, wanted, (*unwanted, *self.exclude))

    def of_vector(self, vector: Embedding) -> Answer:
        """Answer a vector of the encoder's space, or a feature of the field itself.

        One that lies where texts do is asked as words are, if the field keeps a list of words.
        """
        scores = self._field.scores(vector, threads=self.background.threads)
        known = self.background.kept_contrast
        if known is not None and known.speaks(vector):
            return self._of_words(vector, scores, None)
        return self._measured(vector, scores, (None, AUTO))

    @property
    def _field(self) -> LanguageField:
        """The field that is measured and answers, with objects only where the cut asks them."""
        return self.background.field if self.cut.asks_objects else self.background.plain

    def _without(self, answer: Answer, scores: Numbers, wanted: str, unwanted: tuple[str, ...]) -> Answer:
        if not unwanted:
            return answer
        background = self.background
        rivals = rival_scores(self._field, background.encoder, wanted, unwanted, threads=background.threads)
        wholes = (background.by_object(self._field, of) for of in (scores, rivals))
        left = without(*wholes) == UNSELECTED_COSINE
        values = np.where(left, np.float32(answer.lowest), answer.values)
        return replace(answer, values=values, scores=np.where(left, np.float32(UNSELECTED_COSINE), scores))

    def _of_words(self, query: Embedding, scores: Numbers, text: str | None) -> Answer:
        kept = self.background.kept_contrast
        own = self.background.own_threshold if kept is None else None
        if own is not None:
            return self._measured(query, scores, (own, ENCODER))
        known = None if self.cut.measures_relevancy else self.background.contrast_for(text)
        same = None if known is None else self.background.same_kind(known, text)
        values = None if known is None else self._contrasted(known, query, scores, same)
        if known is None or values is None:
            return self._measured(query, scores, (None, AUTO))
        certainty = self._certainty(known, scores, values, same) if len(scores) else NOTHING
        answer = self._cut(query, scores, values, RELEVANCY, (self._list_threshold(known, values, certainty), LIST))
        if answer.rule != LIST or self.cut.present or answer.certainty == NOTHING:
            return answer
        if certainty == SURE:
            better = self._better_swap(scores, text)
            if not better:
                return answer
        elif np.isfinite(self.background.least_peak_of(known)):
            return replace(answer, sure=False, doubt=WEAK_DOUBT)
        else:
            rival, texts = known.rival(query, values, same), self.background.texts_of(known)
            better = texts[rival] if texts and rival is not None else ""
        fits = f"'{better}' fits" if better else "other words fit"
        return replace(answer, sure=False, doubt=f"only maybe: {fits} as well or better")

    def _better_swap(self, scores: Numbers, text: str | None) -> str:
        """Return the text that fits what a text fits best better, though it has another colour or names another thing.

        "" if there is none, and of encoders that have no such texts: of those whose texts are sums of words, "yellow
        mug" fits a yellow chair better than all plain nouns do.
        """
        encoder = self.background.encoder
        others = swapped(text) if text is not None and isinstance(encoder, MiniEncoder) else []
        if text is None or not others:
            return ""
        best = np.argpartition(-scores, min(PEAK_ROWS, len(scores)) - 1)[:PEAK_ROWS]
        shown = self._field.feature(np.sort(best))
        own, *fits = dense_rows(shown, encoder.encode_texts([text, *others]).T, threads=1).mean(0).tolist()
        return others[int(np.argmax(fits))] if max(fits) > own + SWAP_TOLERANCE else ""

    def _certainty(self, known: Contrast, scores: Numbers, values: Numbers, same: OtherFlags | None) -> str:
        """Return whether a text is found for sure, maybe, or not.

        An encoder with a least peak knows few words, which lie far apart: maybe is what fits better than all others,
        but less well than things of the scene usually fit their words.
        """
        least = self.background.least_peak_of(known)
        if not np.isfinite(least):
            return certainty_of(values, known.peak, known.clear_margin, 1 if same is None else int(same.sum()))
        if certainty_of(values, PEAK_ROWS, known.clear_margin) != SURE:
            return NOTHING
        height = peak_score(scores)
        is_maybe = height > MAYBE_LEAST_SHARE * least and not known.of_kind
        return SURE if height > least else MAYBE if is_maybe else NOTHING

    def _list_threshold(self, known: Contrast, values: Numbers, certainty: str) -> float:
        """Return the threshold of values that were compared with a list; the highest where nothing is found.

        What fits better than all words of an encoder that knows few of them is meant.
        """
        if not len(values):
            return RELEVANCY_THRESHOLD
        if certainty == NOTHING and not self.cut.present:
            return float(values.max())
        if certainty == SURE and np.isfinite(self.background.least_peak_of(known)):
            return LIST_RELEVANCY
        return own_level(values, known.peak)

    def _contrasted(
        self, known: Contrast, query: Embedding, scores: Numbers, same: OtherFlags | None
    ) -> Numbers | None:
        """Return relevancies, None where there is nothing to compare with.

        They are those of `lower_partial_fits` where the texts of an encoder are sums of words. A colour has no halves.
        """
        fits = known.raised(query, scores, same, partial(self._field.scores, threads=self.background.threads))
        values = known.relevancy(query, fits, same)
        is_sum = np.isfinite(self.background.least_peak) and not known.of_kind
        return lower_partial_fits(scores, values) if values is not None and is_sum else values

    def _measured(self, query: Embedding, scores: Numbers, default: _Default) -> Answer:
        if not self.cut.measures_relevancy:
            return self._cut(query, scores, scores, COSINE, default)
        values = relevancy_from_scores(scores, self._negatives.maxima)
        return self._cut(query, scores, values, RELEVANCY, (RELEVANCY_THRESHOLD, DEFAULT))

    def _cut(self, query: Embedding, scores: Numbers, values: Numbers, measure: str, default: _Default) -> Answer:
        """Choose the threshold by values of single Gaussians; what objects make of them is compared with it."""
        answered = self.background.by_object(self._field, values)
        threshold, rule = self._threshold(values, answered, default)
        return Answer(self._field, query, answered, measure, threshold, rule, scores)

    def _threshold(self, values: Numbers, answered: Numbers, default: _Default) -> tuple[float, str]:
        given = self.cut
        if given.top_share is not None:
            return share_threshold(answered, given.top_share), SHARE
        if given.threshold is not None and given.threshold != AUTO:
            return float(given.threshold), GIVEN
        cut, rule = default
        return default_threshold(values, cut) if cut is None or rule == ENCODER else cut, rule

    @cached_property
    def _negatives(self) -> Negatives:
        """Those given, else those of the background."""
        field, given, background = self._field, self.cut.negatives, self.background
        if given is None:
            return background.negatives
        if isinstance(given, tuple):
            return text_negatives(field, background.encoder, given, threads=background.threads)
        return field.score_negatives(given, threads=background.threads)


def same_kind(texts: Sequence[str], text: str) -> Flags | None:
    """Mark the texts that name what is of the kind of a text (`names_under`); None: there are none."""
    names = names_under(text)
    same = np.array([one in names for one in texts], np.bool_)
    return same if same.any() else None


def own_threshold(encoder: Encoder) -> float | None:
    """Return the threshold of an encoder whose cosines mean something, and which needs no list to be held against."""
    return None if hasattr(encoder, "nouns") else getattr(encoder, "threshold", None)


def least_peak(encoder: Encoder, known: Contrast | None, peak: int = PEAK_ROWS) -> float:
    """Return the cosine that the best rows exceed: a share of what the list reaches, for encoders that have one."""
    share = getattr(encoder, "least_share", None)
    return -np.inf if share is None or known is None else float(share * known.height(peak))


def lower_partial_fits(scores: Numbers, values: Numbers, peak: int = PEAK_ROWS) -> Numbers:
    """Return relevancies, those of rows that fit half of the query lowered where others fit all of it.

    "Red vase" is not asking for a red shelf.
    """
    if not len(scores):
        return values
    half = scores <= HALF_FIT_SHARE * peak_score(scores, peak)
    return np.where(half, np.minimum(values, np.float32(RELEVANCY_THRESHOLD)), values)


def embedded_image(encoder: Encoder, picture: Pixels) -> Embedding:
    """Embed a picture of a thing as masks are embedded: padded with black to a square.

    Raises: InputError: an encoder of words only.
    """
    if not isinstance(encoder, ImageEncoder):
        raise InputError(
            f"{encoder.identity.name} sees no images: pass encoder=NAME, the model that embedded the masks"
        )
    height, width = picture.shape[:2]
    square = crop(picture, np.ones((height, width), bool), (0, 0, width, height))
    return encoder.encode_images([square])[0]
