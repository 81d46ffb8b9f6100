"""Objects of any scenes, by their descriptors alone: how a query measures them, and above which value it means them.

The rules are those of `measuring`, with an object in place of Gaussians: an object's value is that of the descriptor
that fits best, and one that fits is enough.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..base.arrays import Embedding, Embeddings, Flags, Float32, Numbers, OtherFlags, OtherIndices
from ..errors import InputError, MismatchError
from ..field import relevancy_from_scores
from ..kernels.algebra import dense_rows, row_products
from ..photos.models.word_list import list_vectors, listed_words, rival_vectors
from ..scene.encoders import Encoder, identity_text
from .contrast import Contrast, contrast_of, margin_of, relevancy_threshold
from .defaults import AUTO, COSINE, DEFAULT, ENCODER, GIVEN, LIST, RELEVANCY, RELEVANCY_THRESHOLD
from .encoding import Embedded
from .measuring import embedded_image, least_peak, lower_partial_fits, own_threshold, same_kind
from .query import Query
from .search import NEGATIVES, embed_query, split_negation
from .sentences import parsed
from .thresholds import automatic_threshold, threshold_above

MIN_OBJECTS = 1  # object that fits is enough
OBJECT_CUT_SHARE = 0.8  # of the way to the peak: values of whole objects are further apart than those of Gaussians
MIN_OBJECT_RELEVANCY = 0.35  # some of its Gaussians fit no better than any word


@dataclass(frozen=True, eq=False)
class Described:
    """Objects by what they look like: object i has the unit rows starts[i] to starts[i + 1], one or more."""

    descriptors: Embeddings
    starts: OtherIndices

    def best(self, values: Numbers) -> Float32[np.ndarray, " o"]:
        """Return the highest of each object's values of descriptors."""
        if len(self.starts) < 2:
            return np.empty(0, np.float32)
        return np.asarray(np.maximum.reduceat(values, self.starts[:-1]), np.float32)

    def cosines(self, vector: Embedding) -> Numbers:
        return self.best(self.products(vector))

    def products(self, vector: Embedding) -> Numbers:
        """Return each descriptor's inner product with a vector."""
        return row_products(self.descriptors, vector)


class Ranked(NamedTuple):
    """values: per object. selected: those that the query means: above the threshold, and not excluded."""

    values: Numbers
    selected: Flags
    measure: str
    threshold: float
    rule: str


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Everything that objects are held against. source: makes the encoder of queries; raises where there is none.

    embedded: who made the descriptors. usual: unit descriptors spread over all objects.
    """

    embedded: Embedded
    source: Callable[[], Encoder]
    usual: Embeddings

    @cached_property
    def encoder(self) -> Encoder:
        encoder = self.source()
        self.embedded.check_encoder(encoder.identity)
        return encoder

    @cached_property
    def contrast(self) -> Contrast | None:
        """A list of words, scored at the usual descriptors; None where no list is known."""
        vectors = list_vectors(self.encoder)
        return contrast_of(self.usual, vectors) if len(vectors) and len(self.usual) else None

    def vector(self, query: Query) -> Embedding:
        """Return the unit vector of a query.

        Raises: InputError: a point, a click or a share, which are of one scene; a query that never asks objects; no
        encoder; words that it does not know. MismatchError: a vector of another dimension, or another encoder.
        """
        if any(part is not None for part in (query.point, query.click, query.top_share, query.during)):
            raise InputError(
                "a point, a click, a share and a span of time mean something in one scene only: give words or a picture"
            )
        if not query.asks_objects:
            raise InputError("a catalogue holds nothing but objects: a query that never asks them has no answer there")
        if query.text is not None:
            return self._text(_said(query.text)[0])
        if query.image is not None:
            return _unit(embedded_image(self.encoder, query.image))
        assert query.vector is not None
        if query.vector.shape != (self.embedded.encoder.dim,):
            raise MismatchError(
                f"the query has {query.vector.size} numbers; the descriptors are of "
                f"{identity_text(self.embedded.encoder)}: embed the query with that encoder"
            )
        return _unit(query.vector)

    def rank(self, query: Query, vector: Embedding, objects: Described) -> Ranked:
        """Return how well each object answers. vector: the query's. Raises: as `vector`."""
        cosines = objects.cosines(vector)
        values, measure, threshold, rule = self._measured(query, vector, objects, cosines)
        if query.threshold is not None and query.threshold != AUTO:
            threshold, rule = float(query.threshold), GIVEN
        # objects that the text with an excluded word before it fits as well: "red mug", of "mug, not red"
        out = np.zeros(len(cosines), np.bool_)
        if query.text is not None:
            wanted, unwanted = _said(query.text)
            for word in (*unwanted, *query.exclude):
                out |= objects.cosines(self._text(f"{word} {wanted}")) >= cosines
        return Ranked(values, (values > threshold) & ~out, measure, threshold, rule)

    def _measured(
        self, query: Query, vector: Embedding, objects: Described, cosines: Numbers
    ) -> tuple[Numbers, str, float, str]:
        if query.measures_relevancy:
            rivals = dense_rows(objects.descriptors, self._negatives(query).T, threads=1).max(1)
            values = objects.best(relevancy_from_scores(objects.products(vector), rivals))
            return values, RELEVANCY, RELEVANCY_THRESHOLD, DEFAULT
        own = own_threshold(self.encoder) if query.text is not None else None
        if own is not None:
            return cosines, COSINE, threshold_above(cosines, own, OBJECT_CUT_SHARE, peak=MIN_OBJECTS), ENCODER
        text = None if query.text is None else _said(query.text)[0]
        known = None if text is None else self._contrast_for(text)
        if known is not None and text is not None:
            same = self._same_kind(known, text)
            contrasted = self._contrasted(known, vector, objects, cosines, same)
            if contrasted is not None:
                names = 1 if same is None else int(same.sum())
                return contrasted, RELEVANCY, self._list_threshold(known, cosines, contrasted, names), LIST
        usual = np.concatenate([row_products(self.usual, vector), cosines])  # what objects reach, and the best
        cut = automatic_threshold(usual, OBJECT_CUT_SHARE, peak=MIN_OBJECTS) if len(usual) else 0.0
        return cosines, COSINE, cut, AUTO

    def _contrast_for(self, text: str) -> Contrast | None:
        """Return what a text competes with: words of its own kind where the encoder says so, else a list of words."""
        rivals = rival_vectors(self.encoder, text)
        if rivals is None or not len(self.usual):
            return self.contrast
        return contrast_of(self.usual, rivals, of_kind=True)

    def _same_kind(self, known: Contrast, text: str) -> Flags | None:
        """Mark the words of the list that name what is of a kind, as of one scene (`Background.same_kind`)."""
        if known.of_kind or np.isfinite(least_peak(self.encoder, known, MIN_OBJECTS)):
            return None
        return same_kind(listed_words(self.encoder)[0], text)

    def _contrasted(
        self, known: Contrast, vector: Embedding, objects: Described,
        cosines: Numbers, same: OtherFlags | None,
    ) -> Numbers | None:  # fmt: skip
        fits = known.raised(
            vector, objects.products(vector), same, lambda some: dense_rows(objects.descriptors, some.T, threads=1).T
        )
        values = known.at(objects.descriptors).relevancy(vector, fits, same)
        if values is None:
            return None
        values = objects.best(values)
        is_sum = np.isfinite(least_peak(self.encoder, known, MIN_OBJECTS)) and not known.of_kind
        return lower_partial_fits(cosines, values, MIN_OBJECTS) if is_sum else values

    def _list_threshold(self, known: Contrast, cosines: Numbers, values: Numbers, names: int) -> float:
        """Return the threshold; the highest value where nothing stands out, or no cosine is high enough.

        names: that answer the query.
        """
        least = relevancy_threshold(values, MIN_OBJECTS, margin_of(known.clear_margin, names))
        if not len(values) or least != RELEVANCY_THRESHOLD:
            return least
        if cosines.max() <= least_peak(self.encoder, known, MIN_OBJECTS):
            return float(values.max())
        return threshold_above(values, MIN_OBJECT_RELEVANCY, OBJECT_CUT_SHARE, peak=MIN_OBJECTS)

    def _negatives(self, query: Query) -> Embeddings:
        given = NEGATIVES if query.negatives is None else query.negatives
        if isinstance(given, tuple):
            return np.stack([self._text(text) for text in given])
        return np.stack([_unit(vector) for vector in given])

    def _text(self, text: str) -> Embedding:
        return _unit(embed_query(self.encoder, self.embedded, text))


def _said(text: str) -> tuple[str, tuple[str, ...]]:
    """Return what a text wants and what it does not. Raises: InputError: it says how two things lie."""
    sentence = parsed(text)
    if sentence.relation:
        raise InputError(
            f"'{text}': a catalogue knows single objects and not how they lie: ask it for "
            f"'{sentence.text or sentence.others[0]}', and a scene that has it for the rest"
        )
    return split_negation(sentence.text)


def _unit(vector: Embedding) -> Embedding:
    length = float(np.linalg.norm(vector.astype(np.float64)))
    if not np.isfinite(length) or not length > 0:
        raise InputError("embeddings to compare with must be finite and not zero")
    return np.asarray(vector / length, np.float32)
