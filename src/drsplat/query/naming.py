"""The best words for a feature, those that an encoder is sure of, and whether its nouns are to be believed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.arrays import Embedding, Embeddings, OtherEmbeddings
from ..errors import InputError
from ..field import LanguageField
from ..formats.vocabulary import VocabularyEncoder
from ..kernels.algebra import dense_rows, row_products
from ..photos.models.mini import MiniEncoder
from ..photos.models.mini.lexicon import COLORS, NAMES, STRUCTURES, nouns_in
from ..photos.models.word_list import list_vectors
from ..scene.encoders import Encoder
from .contrast import MIN_SPREAD, SAME_MEANING_COSINE, USUAL_COSINE_SHARE, usual_pictures

SAMPLED_ROWS = 1000
MAX_USUAL_PICTURES = 1024
SURE_MARGIN, SURE_COLOR_MARGIN = 0.5, 1.0  # standard deviations of a word that things are called by
ONLY_COLORS_DOUBT = (
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
    cosines = dense_rows(field.feature(rows), encoder.encode_texts(encoder.nouns).T, threads=1)
    return float(np.median(cosines.max(1)))


def doubt_of(encoder: Encoder, field: LanguageField, text: str | None = None) -> str:
    """Return the reason not to believe the nouns of a text, or of names, in a scene; "" if there is none."""
    if text is not None and not nouns_in(text):
        return ""
    return "" if knows_nouns(encoder, field) else ONLY_COLORS_DOUBT


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
    """Return a word for each of some nodes where the encoder is sure of it, else None.

    What a node is called by is its first descriptor: that of most of its weight. The best word has to fit clearly
    better than every other of the list that means something else, each word's usual fit taken off (`_sure`).

    Args:
        encoder: who embeds words.
        field: the field that the nodes are of.
        nodes: those of its objects.
        words: to choose from; where there are none, the encoder's own; None for all nodes where it takes any.

    Raises:
        MismatchError: another encoder. InputError: words that it does not know.
    """
    objects = field.objects
    if objects is None or not len(nodes):
        return [None] * len(nodes)
    field.check_encoder(encoder.identity)
    firsts = [objects.descriptors_of(node)[:1] for node in nodes]
    seen = _Seen(
        usual_pictures(field, MAX_USUAL_PICTURES), np.concatenate(firsts), [len(first) > 0 for first in firsts]
    )
    if isinstance(encoder, MiniEncoder) and not words:
        return _household_names(encoder, seen, knows_nouns(encoder, field))
    texts = tuple(words) or own_vocabulary(encoder, field)
    if not texts:
        return [None] * len(nodes)
    return _sure_texts(encoder, seen, texts, SURE_MARGIN, list_vectors(encoder) if words else None)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Descriptors to be named. pictures: usual ones of the scene. rows: a descriptor for each node that `has` one."""

    pictures: OtherEmbeddings
    rows: Embeddings
    has: list[bool]


def _household_names(encoder: MiniEncoder, seen: _Seen, nouns: bool) -> list[str | None]:
    """Return "red mug", "mug" or "something red" of the built-in encoder. nouns: whether they are to be believed.

    The scene then looks like the rooms that the taught colours are from; elsewhere those of photos name things.
    """
    texts = [f"something {color}" for color in COLORS]
    if not nouns:
        return _sure_texts(encoder, seen, texts, SURE_COLOR_MARGIN)
    paints = _sure(seen, texts, encoder.taught_colors, encoder.taught_colors, SURE_COLOR_MARGIN)
    names = _sure_texts(encoder, seen, encoder.nouns, SURE_MARGIN)
    return [
        f"{paint.removeprefix('something ')} {name}" if paint and name in NAMES else name or paint
        for name, paint in zip(names, paints, strict=True)
    ]


def _sure_texts(
    encoder: Encoder, seen: _Seen, texts: Sequence[str], least: float, rivals: Embeddings | None = None
) -> list[str | None]:
    """Return the text that each node is called by, None for none. rivals: further words that it has to exceed."""
    vectors = np.asarray(encoder.encode_texts(texts), np.float32)
    return _sure(seen, texts, vectors, vectors if rivals is None else np.concatenate([vectors, rivals]), least)


def _sure(
    seen: _Seen, texts: Sequence[str], vectors: Embeddings, every: OtherEmbeddings, least: float
) -> list[str | None]:
    """Return the text that each node is called by, None for none and where another word fits nearly as well.

    vectors: of the texts, with which `every` begins. least: by how much the best exceeds all that do not mean the same,
    in standard deviations of cosines of words and pictures once the means of both are off, as of `Contrast.spread`.
    """
    cosines, scores = (dense_rows(rows, every.T, threads=1) for rows in (seen.pictures, seen.rows))
    scores -= np.float32(USUAL_COSINE_SHARE) * cosines.mean(0)
    best = scores[:, : len(vectors)].argmax(1)
    centered = every - every.mean(0, dtype=np.float64)
    centered /= np.maximum(np.linalg.norm(centered, axis=1, keepdims=True), 1e-12)
    alike = (centered[best] @ centered.T > SAME_MEANING_COSINE) | (vectors[best] @ every.T > 1 - 1e-5)
    others = np.where(alike, -np.inf, scores).max(1)
    cosines -= cosines.mean(0)
    cosines -= cosines.mean(1, keepdims=True)
    margins = (scores[np.arange(len(best)), best] - others) / max(float(cosines.std()), MIN_SPREAD)
    words = iter(np.where(margins >= least, best, -1).tolist())
    chosen = [next(words) if has else -1 for has in seen.has]
    return [texts[word] if word >= 0 else None for word in chosen]


def best_names(
    encoder: Encoder, field: LanguageField, feature: Embedding, vocabulary: Sequence[str] | None, top: int
) -> list[tuple[str, float]]:
    """Return the `top` texts of the highest cosine with a unit feature, best first.

    Raises: InputError: no texts. MismatchError: another encoder.
    """
    texts = own_vocabulary(encoder, field) if vocabulary is None else tuple(dict.fromkeys(vocabulary))
    if not texts:
        raise InputError(f"the encoder '{encoder.identity.name}' takes any words: name those to choose from")
    field.check_encoder(encoder.identity)
    vectors = np.asarray(encoder.encode_texts(texts), np.float32)
    scores = row_products(vectors, feature)
    order = np.argsort(-scores, kind="stable")[:top]
    return [(texts[at], float(scores[at])) for at in order]
