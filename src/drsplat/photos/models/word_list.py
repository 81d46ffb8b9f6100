"""Which words a query is contrasted with."""

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from ...base.arrays import Float32
from ...errors import InputError
from ...formats.vocabulary import VocabularyEncoder
from ...scene.encoders import Encoder
from .nouns import NOUNS, broad_list

MAX_TEXTS = 2000  # of a vocabulary: more make a first question slow


def list_vectors(encoder: Encoder) -> Float32[np.ndarray, "n D"]:
    """Return the vectors of all texts of a vocabulary, of the encoder's own nouns, or of those that ship."""
    return listed_words(encoder)[1]


def listed_words(encoder: Encoder) -> tuple[Sequence[str], Float32[np.ndarray, "n D"]]:
    """Return the texts of `list_vectors`, and these."""
    if encoder not in _EMBEDDED:
        if isinstance(encoder, VocabularyEncoder):
            texts = _spread_over(encoder.texts)
            _EMBEDDED[encoder] = texts, np.asarray(encoder.encode_texts(texts), np.float32)
        else:
            _EMBEDDED[encoder] = known_words(encoder, getattr(encoder, "nouns", None) or broad_list())
    return _EMBEDDED[encoder]


def rival_vectors(encoder: Encoder, text: str | None) -> Float32[np.ndarray, "n D"] | None:
    """Return the vectors of the few words that a text competes with; None: those of the list.

    text: None for a query that is no text. An encoder of few words may have `rivals`, see `MiniEncoder.rivals`.
    """
    rivals = getattr(encoder, "rivals", None)
    return None if rivals is None or text is None else rivals(text)


_EMBEDDED: "WeakKeyDictionary[Encoder, tuple[Sequence[str], Float32[np.ndarray, 'n D']]]" = WeakKeyDictionary()


def known_words(encoder: Encoder, words: Sequence[str]) -> tuple[list[str], Float32[np.ndarray, "n D"]]:
    """Return those of some words that an encoder can read, and their vectors."""
    try:
        return list(words), np.asarray(encoder.encode_texts(words), np.float32)
    except InputError:  # an encoder of some words, or of short ones
        pairs = [(word, vector) for word in words for vector in _if_known(encoder, word)]
    vectors = np.asarray([vector for _, vector in pairs], np.float32)
    return [word for word, _ in pairs], vectors.reshape(len(pairs), encoder.identity.dim)


def _if_known(encoder: Encoder, noun: str) -> Sequence[Float32[np.ndarray, " D"]]:
    try:
        return list(encoder.encode_texts([noun]))
    except InputError:
        return ()


def _spread_over(texts: Sequence[str]) -> Sequence[str]:
    """Return all texts, or of a large vocabulary the nouns of the list and others spread over it."""
    if len(texts) <= MAX_TEXTS:
        return texts
    nouns = [text for text in texts if text in set(NOUNS)]
    others = [text for text in texts if text not in set(NOUNS)]
    spread = np.linspace(0, len(others) - 1, MAX_TEXTS - len(nouns)).astype(int)
    return [*nouns, *(others[at] for at in np.unique(spread))]
