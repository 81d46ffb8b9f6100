"""The best words for a feature, and whether the nouns among them are to be believed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from ..encoders import Encoder
from ..errors import InputError
from ..field import LanguageField
from ..formats.vocabulary import VocabularyEncoder
from ..models.mini import MiniEncoder
from ..models.mini.lexicon import COLORS, NAMES, STRUCTURES, nouns_in

SAMPLED_ROWS = 1000
ONLY_COLORS = (
    "the built-in encoder learnt nouns from made-up rooms and this scene looks unlike them, so only its colours can be "
    "trusted ('something red'): for names embed the photos with SAM and CLIP (`drsplat embed CAPTURE`), then register"
)


def knows_nouns(encoder: Encoder, field: LanguageField) -> bool:
    """Return whether a scene looks like what an encoder learnt nouns from; True for encoders that do not say.

    Photos of a thing agree on what it is where the encoder knows such things: `fit_of` is high there.
    """
    return not isinstance(encoder, MiniEncoder) or not len(field) or fit_of(encoder, field) >= encoder.least_fit


def fit_of(encoder: MiniEncoder, field: LanguageField) -> float:
    """Return the cosine of the best noun that half of a field's features reach."""
    rows = np.unique(np.linspace(0, len(field) - 1, SAMPLED_ROWS).astype(np.intp))
    return float(np.median((field.feature(rows) @ encoder.encode_texts(encoder.nouns).T).max(axis=1)))


def doubt_of(encoder: Encoder, field: LanguageField, text: str | None = None) -> str:
    """Return the reason not to believe the nouns of a text, or of names, in a scene; "" if there is none."""
    if text is not None and not nouns_in(text):
        return ""
    return "" if knows_nouns(encoder, field) else ONLY_COLORS


def own_vocabulary(encoder: Encoder, field: LanguageField) -> tuple[str, ...] | None:
    """Return the texts that an encoder can name things of a field by, None where it takes any."""
    if isinstance(encoder, MiniEncoder):
        if not knows_nouns(encoder, field):
            return tuple(f"something {color}" for color in COLORS)
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
    texts, objects = tuple(words) or own_vocabulary(encoder, field), field.objects
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
    texts = own_vocabulary(encoder, field) if vocabulary is None else tuple(dict.fromkeys(vocabulary))
    if not texts:
        raise InputError(f"the encoder '{encoder.identity.name}' takes any words: name those to choose from")
    field.check_encoder(encoder.identity)
    vectors = np.asarray(encoder.encode_texts(texts), np.float32)
    scores = vectors @ feature
    order = np.argsort(-scores, kind="stable")[:top]
    return [(texts[at], float(scores[at])) for at in order]
