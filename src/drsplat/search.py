"""Words to scores: the whole query path on one screen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from .encoders import Encoder
from .errors import InputError
from .field import LanguageField, Negatives, relevancy_from_scores

__all__ = ["NEGATIVES", "Answer", "embed_query", "query", "relevancy_from_scores", "text_negatives"]

NEGATIVES = ("object", "things", "stuff", "texture")


@dataclass(frozen=True, eq=False)
class Answer:
    """One number per row of the field.

    scores: cosines. relevancy: in (0, 1), 0.5 where the query fits no better than a negative.
    """

    scores: Float32[np.ndarray, " r"]
    relevancy: Float32[np.ndarray, " r"]


def embed_query(encoder: Encoder, field: LanguageField, text: str) -> Float32[np.ndarray, " D"]:
    """The unit vector of a text.

    Raises: MismatchError: the field was written with another encoder.
    """
    field.check_encoder(encoder.identity)
    return np.asarray(encoder.encode_texts([text])[0], np.float32)


def text_negatives(
    field: LanguageField, encoder: Encoder, texts: Sequence[str] = NEGATIVES, *, threads: int = 0
) -> Negatives:
    """The field's own negatives if they are of these texts; otherwise they are embedded and scored.

    Raises: MismatchError: the field was written with another encoder. InputError: no texts.
    """
    field.check_encoder(encoder.identity)
    if not texts:
        raise InputError("relevancy needs at least one negative text")
    if field.negatives is not None and field.negatives.texts == tuple(texts):
        return field.negatives
    embeddings = np.asarray(encoder.encode_texts(texts), np.float32)
    return field.score_negatives(embeddings, tuple(texts), threads=threads)


def query(
    field: LanguageField,
    encoder: Encoder,
    text: str,
    negatives: Sequence[str] = NEGATIVES,
    *,
    threads: int = 0,
) -> Answer:
    """Score every registered Gaussian against a text: one scan if the negatives are cached.

    Raises: MismatchError: the field was written with another encoder. InputError: no negatives.
    Source: Dr. Splat Sec. A "Inference stage"; Kerr et al. 2023 (LERF) for relevancy.
    """
    compared = text_negatives(field, encoder, negatives, threads=threads)
    scores = field.scores(embed_query(encoder, field, text), threads=threads)
    return Answer(scores, relevancy_from_scores(scores, compared.maxima))
