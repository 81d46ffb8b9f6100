"""The best words for a feature."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from ..encoders import Encoder
from ..errors import InputError
from ..field import LanguageField
from ..formats.vocabulary import VocabularyEncoder
from ..models.mini import MiniEncoder
from ..models.mini.lexicon import COLORS, NAMES, STRUCTURES


def own_vocabulary(encoder: Encoder) -> tuple[str, ...] | None:
    """The texts that an encoder can be asked for by itself, None where it takes any."""
    if isinstance(encoder, MiniEncoder):
        colored = tuple(f"{color} {name}" for name in NAMES for color in COLORS)
        return (*NAMES, *STRUCTURES, *colored)
    if isinstance(encoder, VocabularyEncoder):
        return encoder.texts
    return None


def object_names(
    encoder: Encoder, field: LanguageField, nodes: Sequence[int], words: Sequence[str] = ()
) -> list[str | None]:
    """The best of some words for each of some nodes; None where none fits.

    words: where there are none, the encoder's own; None for all nodes where it takes any. A word has to exceed the
    threshold of an encoder that has one. Raises: MismatchError: another encoder. InputError: words that it does not
    know.
    """
    texts, objects = tuple(words) or own_vocabulary(encoder), field.objects
    if not texts or objects is None:
        return [None] * len(nodes)
    field.check_encoder(encoder.identity)
    vectors, least = np.asarray(encoder.encode_texts(texts), np.float32), getattr(encoder, "threshold", -1.0)
    names: list[str | None] = []
    for node in nodes:
        scores = (objects.descriptors_of(node) @ vectors.T).max(axis=0, initial=-1)
        names.append(texts[scores.argmax()] if scores.max() > least else None)
    return names


def best_names(
    encoder: Encoder,
    field: LanguageField,
    feature: Float32[np.ndarray, " D"],
    vocabulary: Sequence[str] | None,
    top: int,
) -> list[tuple[str, float]]:
    """The `top` texts of the highest cosine with a unit feature, best first.

    Raises: InputError: no texts. MismatchError: another encoder.
    """
    texts = own_vocabulary(encoder) if vocabulary is None else tuple(dict.fromkeys(vocabulary))
    if not texts:
        raise InputError(f"the encoder '{encoder.identity.name}' takes any words: name those to choose from")
    field.check_encoder(encoder.identity)
    vectors = np.asarray(encoder.encode_texts(texts), np.float32)
    scores = vectors @ feature
    order = np.argsort(-scores, kind="stable")[:top]
    return [(texts[at], float(scores[at])) for at in order]
