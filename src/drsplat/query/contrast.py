"""How much better a query fits than a broad list of words: where nobody knows which cosine is high enough.

Cosines of CLIP-like encoders depend on the word and on the picture more than on whether they fit. So a
query is compared, at each Gaussian, with what the words of a list reach there, and each word's usual
cosine with the pictures of the scene counts half. See docs/method.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from weakref import WeakKeyDictionary

import numpy as np

from ..base.arrays import Array, Bool, Embedding, Embeddings, Flags, Float, Float32, Float64, Integer, UInt16
from ..base.contents import release, scratch
from ..field import LanguageField
from ..kernels.algebra import dense_rows, row_products
from ..kernels.scan import keep_best
from .defaults import MAYBE, NOTHING, SURE
from .thresholds import PEAK_ROWS, clear_threshold, peak_score

USUAL_COSINE_SHARE = 0.5  # taken off a word's cosines: all of it would punish what is everywhere
SAME_MEANING_COSINE = 0.5  # of two texts, seen from their mean: they do not compete
WORDS_PER_RIVAL = 300  # one word of so many may fit better than the query
SPARE_WORDS = 8  # per row, beyond those that count, for when some are near to the query
MAX_USUAL_PICTURES = 4096
MIN_SPREAD = 1e-3
LIST_RELEVANCY = 0.5  # of what fits as well as the list
CLEAR_MARGIN, CLEAR_MARGIN_PER_EFOLD = 0.45, 0.05  # spreads that a peak stands above the list, and more in more rows
LONG_LIST_CLEAR_MARGIN = 0.5  # for lists of WORDS_PER_RIVAL words and more
KIND_CLEAR_MARGIN = 0.6  # for words of one kind, such as colours, of which a photo has nearly all a little
KIND_MARGIN_PER_EFOLD = 0.3  # more, for a query that any of several names may answer
CLEAR_MARGIN_ROWS = 50_000  # that CLEAR_MARGIN is for
MAYBE_SPREADS = 0.5  # by which a peak may miss the clear margin and still be shown
OWN_THRESHOLD_SHARE = 0.6  # against the level of the list
WAY_TO_PEAK_SHARE = 0.7  # from the middle
PEAK_SHARE, MIN_PEAK_ROWS = 1 / 3000, 10  # of the rows: a peak above a long list, in scenes of less than 120,000 rows
LARGE_SCENE_PEAK_SHARE = 1 / 500  # of the rows
Score = Callable[[np.ndarray], np.ndarray]
WORDS_AT_ONCE = 8
MAX_WORDS_AT_ONCE, MAX_SCORES_AT_ONCE = 256, 1 << 20  # of few rows, whose products with 8 words at once would be slow
ROWS_AT_ONCE = 1 << 18


@dataclass(frozen=True, eq=False)
class Contrast:
    """Scores that the words of a list reach at each row of a field.

    vectors: their unit embeddings. usual: the mean picture, times USUAL_COSINE_SHARE. spread: standard deviation of
    cosines of words with pictures once the means of both are taken off: the unit of margins. scores, words:
    per row the best of the list, best first, and which ones they are. of_kind: the words are of one kind, such as
    colours, and no broad list. counts: rows of the field that each row here stands for, in order; None for one.
    """

    vectors: Embeddings
    usual: Embedding
    spread: float
    scores: Float32[Array, "r t"]
    words: UInt16[Array, "r t"]
    of_kind: bool = False
    counts: Integer[Array, " r"] | None = None

    @property
    def num_rows(self) -> int:
        return len(self.scores) if self.counts is None else int(self.counts.sum())

    @property
    def clear_margin(self) -> float:
        """Spreads that the peak of a query has to stand above the list. Of few words one often fits nearly as well."""
        if self.of_kind:
            return KIND_CLEAR_MARGIN
        return LONG_LIST_CLEAR_MARGIN if len(self.vectors) >= WORDS_PER_RIVAL else CLEAR_MARGIN

    @property
    def peak(self) -> int:
        """Rows that have to stand above the list. Of long lists fewer in small scenes, whose things have fewer rows."""
        if len(self.vectors) < WORDS_PER_RIVAL:
            return PEAK_ROWS
        return min(PEAK_ROWS, max(MIN_PEAK_ROWS, round(PEAK_SHARE * self.num_rows)))

    def height(self, peak: int = PEAK_ROWS) -> float:
        """Return the cosine that as many rows as make a thing reach with the word of the list that fits each best."""
        levels = row_products(self.vectors, self.usual)[self.words]
        return peak_score(self._of_each((self.scores + levels).max(1)), peak) if len(self.scores) else 0.0

    def relevancy(
        self, query: Embedding, scores: Float32[Array, " r"], same: Flags | None = None
    ) -> Float32[Array, " r"] | None:
        """Return values in (0, 1): above 0.5 where the query fits better than all words but one in WORDS_PER_RIVAL.

        query: the vector of a text. scores: its cosines. same: words that do not compete with it beside those that mean
        the same, as those of its kind. None: no word of the list means anything else.
        """
        query = query / np.linalg.norm(query)
        near = self._not_competing(query, same)
        if near.all():
            return None
        if self.counts is not None:
            scores = scores[np.cumsum(self.counts) - self.counts]
        rank = max(1, round(int((~near).sum()) / WORDS_PER_RIVAL))
        values, usual = np.empty(len(scores), np.float32), np.float32(query @ self.usual)
        for begin in range(0, len(scores), ROWS_AT_ONCE):
            run = slice(begin, begin + ROWS_AT_ONCE)
            # Per row of a run the score of the `rank`-th best word that is not near, or of the last one kept
            better = np.cumsum(np.take(~near, self.words[run].T), axis=0, dtype=np.uint16) < rank
            places = np.minimum(better.sum(0, dtype=np.uint16), len(better) - 1)
            margins = (scores[run] - usual - np.asarray(self.scores[run][np.arange(len(places)), places])) / self.spread
            values[run] = 1 / (1 + np.exp(-np.clip(margins, -50, 50)))
            release(self.scores, self.words)
        return self._of_each(values)

    def _not_competing(self, query: Embedding, same: Flags | None) -> Flags:
        near = _near(self.vectors, query)
        return near if same is None else near | same

    def _of_each(self, values: Float32[Array, " r"]) -> Float32[Array, " f"]:
        """Return the values of all rows of the field."""
        return values if self.counts is None else np.repeat(values, self.counts)

    def speaks(self, query: Embedding) -> bool:
        """Return whether a vector lies with the words rather than with the pictures."""
        sides = np.stack([self.vectors.mean(0), self.usual]).astype(np.float64)
        to_words, to_pictures = row_products(sides / np.linalg.norm(sides, axis=1, keepdims=True), query)
        return bool(to_words > to_pictures)

    def raised(
        self, query: Embedding, scores: Float32[Array, " r"], same: Flags | None, score: Score
    ) -> Float32[Array, " r"]:
        """Return the cosines of a query, raised to those of the best name of its kind, what is usual of each taken off.

        same: the names of its kind, None for none. score: gives the cosines (c, r) of some vectors.
        """
        if same is None:
            return scores
        best, vectors = scores.copy(), self.vectors[same]
        usual = row_products(vectors, self.usual) - np.float32(query @ self.usual)
        for begin in range(0, len(vectors), WORDS_AT_ONCE):
            some = slice(begin, begin + WORDS_AT_ONCE)
            np.maximum(best, (score(vectors[some]) - usual[some, None]).max(axis=0), out=best)
        return best

    def rival(self, query: Embedding, values: Float32[Array, " r"], same: Flags | None = None) -> int | None:
        """Return the number of the word that fits best where the query fits best; None: none that means another thing.

        values: relevancies of the query, one per row of the field. same: as of `relevancy`.
        """
        near = self._not_competing(query / np.linalg.norm(query), same)
        words = self.words if self.counts is None else np.repeat(self.words, self.counts, axis=0)
        best = words[np.argsort(-values, kind="stable")[: self.peak]]
        others = ~near[best]
        first = best[np.arange(len(best)), others.argmax(1)][others.any(1)]
        return int(np.bincount(first).argmax()) if len(first) else None

    def at(self, features: Float32[Array, "m D"]) -> "Contrast":
        """Return what the words reach at other unit features, held against the same pictures."""
        scores, words = _best_words_of(features, self.vectors, self.usual)
        return replace(self, scores=scores, words=words)


def _near(vectors: Embeddings, query: Embedding) -> Flags:
    """Mark the words that mean the same as the unit query. The last answer is kept: many scenes ask with one list."""
    global _last_near
    last = _last_near
    if last is None or last[0] is not vectors or not np.array_equal(last[1], query):
        last = _last_near = vectors, query, near_each(vectors, query[None])[:, 0]
    return last[2]


def near_each(vectors: Embeddings, queries: Float32[Array, "q D"]) -> Bool[Array, "n q"]:
    """Mark the words that mean the same as each of some unit queries.

    Both are seen from the mean of the list and the query: with c = n + 1 texts and all from the list's mean, that of a
    query q is q / c.
    """
    middle, count = vectors.mean(0, dtype=np.float64), len(vectors) + 1
    words, texts = vectors - middle, queries - middle
    products, squares = words @ texts.T, (texts * texts).sum(1) / count
    lengths = (words * words).sum(1)[:, None] - 2 / count * products + squares / count
    cosines = (products - squares) / np.sqrt(np.maximum(lengths * squares * count, 1e-24))
    return np.asarray((vectors @ queries.T > 1 - 1e-5) | (cosines > SAME_MEANING_COSINE))


def contrast(field: LanguageField, vectors: Embeddings, *, threads: int = 0) -> Contrast:
    """Score a list of words once; 6 (n / WORDS_PER_RIVAL + SPARE_WORDS) bytes per row. The last one of a field is kept.

    Raises: MismatchError: vectors of another dimension.
    """
    known = _LAST_CONTRASTS.get(field)
    if known is None or not np.array_equal(known.vectors, vectors):
        known = _LAST_CONTRASTS[field] = _contrast(field, vectors, threads)
    return known


def contrast_of_kind(field: LanguageField, vectors: Embeddings, *, threads: int = 0) -> Contrast:
    """Score a few words of one kind that a text competes with in place of the list, which stays the one that is kept.

    What is usual counts half for them too: a scene of greys in all lights takes some of its black and white for grey.
    """
    return replace(_contrast(field, vectors, threads), of_kind=True)


def contrast_of(
    features: Float32[Array, "m D"],
    vectors: Embeddings,
    *,
    pictures: Float32[Array, "s D"] | None = None,
    of_kind: bool = False,
) -> Contrast:
    """Score words at unit features without a field. pictures: of the scene; None: the features themselves."""
    usual, spread = _usual(features if pictures is None else pictures, vectors, threads=1)
    scores, words = _best_words_of(features, vectors, usual)
    return Contrast(vectors, usual, spread, scores, words, of_kind)


def relevancy_threshold(
    relevancy: Float32[Array, " r"], peak: int = PEAK_ROWS, clear_margin: float = CLEAR_MARGIN
) -> float:
    """Return 0.5, or the highest where too few rows stand clearly above: then nothing is found."""
    return clear_threshold(relevancy, LIST_RELEVANCY, least_clear(len(relevancy), clear_margin), peak=peak)


def least_clear(rows: int, margin: float = CLEAR_MARGIN) -> float:
    """Return the relevancy that the peak of a query has to exceed: of more rows more fit any word by chance."""
    return _sigmoid(margin + CLEAR_MARGIN_PER_EFOLD * float(np.log(max(rows, CLEAR_MARGIN_ROWS) / CLEAR_MARGIN_ROWS)))


def certainty_of(relevancy: Float32[Array, " r"], peak: int, clear_margin: float, names: int = 1) -> str:
    """Return whether a query is found for sure, maybe, or not at all, by how far its peak stands above the list.

    Maybe: it misses the clear margin by at most `MAYBE_SPREADS`, because another word fits nearly as well or better.
    names: that answer the query, each of which may fit something by chance.
    """
    height, clear_margin = peak_score(relevancy, peak), margin_of(clear_margin, names)
    return next(
        (said for margin, said in ((clear_margin, SURE), (clear_margin - MAYBE_SPREADS, MAYBE))
         if height > least_clear(len(relevancy), margin)),
        NOTHING,
    )  # fmt: skip


def margin_of(clear_margin: float, names: int) -> float:
    """Return the clear margin of a query that any of several names may answer."""
    return clear_margin + KIND_MARGIN_PER_EFOLD * float(np.log(max(names, 1)))


def own_level(relevancy: Float32[Array, " r"], peak: int = PEAK_ROWS) -> float:
    """Return a threshold that leaves out what fits a query in part, whether or not all of it stands above the list.

    In margins: 0.6 of what is 0.7 of the way from the median of what fits worse than the list to what 1 in 500 reaches,
    or `peak` rows. The level of the list alone lets in what fits a little; the query's own values alone leave out half
    of what fits in part.
    """
    worse = np.sort(relevancy[relevancy < LIST_RELEVANCY])
    middle = float(_margin(worse[[(len(worse) - 1) // 2, len(worse) // 2]]).mean()) if len(worse) else 0.0
    height = float(_margin(np.array(peak_score(relevancy, max(peak, round(LARGE_SCENE_PEAK_SHARE * len(relevancy)))))))
    return _sigmoid(OWN_THRESHOLD_SHARE * (middle + WAY_TO_PEAK_SHARE * (height - middle)))


def _margin(relevancy: Float[Array, "*any"]) -> Float64[Array, "*any"]:
    """Return what `_sigmoid` makes relevancies of; it rises with them, so that quantiles may be taken before."""
    inside = np.clip(relevancy.astype(np.float64), 1e-12, 1 - 1e-12)
    return np.asarray(np.log(inside / (1 - inside)))


def usual_pictures(field: LanguageField, most: int = MAX_USUAL_PICTURES) -> Float32[Array, "s D"]:
    """Return embeddings of masks spread over the photos; where they were not kept, features of Gaussians."""
    evidence = field.evidence
    count = len(field) if evidence is None else len(evidence.embeddings)
    rows = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
    return field.feature(rows) if evidence is None else np.asarray(evidence.embeddings[rows])


_last_near: tuple[Array, Array, Array] | None = None
_LAST_CONTRASTS: "WeakKeyDictionary[LanguageField, Contrast]" = WeakKeyDictionary()


def _contrast(field: LanguageField, vectors: Embeddings, threads: int) -> Contrast:
    usual, spread = _usual(usual_pictures(field), vectors, threads)
    runs = [(run, partial(field.scores, threads=threads, code=code)) for run, code in field.runs()]
    scores, words = _best_words(vectors, usual, runs, threads)
    return Contrast(vectors, usual, spread, scores, words)


def _usual(pictures: Float32[Array, "s D"], vectors: Embeddings, threads: int) -> tuple[Embedding, float]:
    """Return the mean picture times USUAL_COSINE_SHARE, and the unit of margins."""
    usual = (USUAL_COSINE_SHARE * pictures.mean(0, dtype=np.float64)).astype(np.float32)
    return usual, _spread(dense_rows(pictures, vectors.T, threads=threads))


def _best_words(
    vectors: Embeddings,
    usual: Embedding,
    runs: Sequence[tuple[slice, Score]],
    threads: int = 1,
    at_once: int = WORDS_AT_ONCE,
) -> tuple[Float32[Array, "r t"], UInt16[Array, "r t"]]:
    """Return the best words. runs: rows, and what gives the cosines (c, r) of `at_once` words with them."""
    kept = min(len(vectors), max(1, round(len(vectors) / WORDS_PER_RIVAL)) + SPARE_WORDS)
    rows = runs[-1][0].stop
    scores, words = scratch((kept, rows), np.float32), scratch((kept, rows), np.uint16)
    for run, score in runs:
        shape = kept, run.stop - run.start
        own, names = np.full(shape, -np.inf, np.float32), np.zeros(shape, np.uint16)
        for begin in range(0, len(vectors), at_once):
            some = vectors[begin : begin + at_once]
            keep_best(own, names, score(some) - row_products(some, usual)[:, None], begin, threads=threads)
        scores[:, run], words[:, run] = own, names
        release(scores, words)
    return scores.T, words.T


def _best_words_of(
    features: Float32[Array, "m D"], vectors: Embeddings, usual: Embedding
) -> tuple[Float32[Array, "m t"], UInt16[Array, "m t"]]:
    at_once = max(WORDS_AT_ONCE, min(MAX_WORDS_AT_ONCE, MAX_SCORES_AT_ONCE // max(len(features), 1)))
    runs = [(slice(0, len(features)), lambda some: dense_rows(features, some.T, threads=1).T)]
    return _best_words(vectors, usual, runs, at_once=at_once)


def _sigmoid(margin: float) -> float:
    return 1 / (1 + float(np.exp(-margin)))


def _spread(cosines: Float64[Array, "s n"] | Float32[Array, "s n"]) -> float:
    """Return the standard deviation of what is left of cosines without the means of words and pictures."""
    left = cosines - cosines.mean(0)
    if left.shape[1] > 1:
        left = left - left.mean(1, keepdims=True)
    return max(float(left.std()), MIN_SPREAD)
