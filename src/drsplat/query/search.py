"""Words to scores, a click to a query."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arrays import DoubleRows, Embedding, FloatRows, IndexRows, Indices, MaskIds, Numbers, OtherIndices
from ..errors import InputError
from ..field import LanguageField, Negatives
from ..kernels import SplatArrays, view_weights
from ..scene.encoders import Encoder
from ..scene.views import View
from .encoding import Embedded

NEGATIVES = ("object", "things", "stuff", "texture")


class PixelWeights(NamedTuple):
    """The largest blending weights of some pixels, and the Gaussians' rows, descending; padded with -1 and 0."""

    gaussian_ids: IndexRows
    weights: FloatRows


UNSELECTED_COSINE = -1.0  # which no threshold selects
QUERIES_AT_ONCE = 8  # whose scores are held
BUT_NOT = re.compile(r"\s*,\s*(?:(?:and|but)\s+)?not(?:\s+|$)|\s+but\s+not(?:\s+|$)", re.IGNORECASE)


def embed_query(encoder: Encoder, field: Embedded, text: str) -> Embedding:
    """Return the unit vector of a text. Raises: MismatchError: the field was written with another encoder."""
    field.check_encoder(encoder.identity)
    return np.asarray(encoder.encode_texts([text])[0], np.float32)


def text_negatives(
    field: LanguageField, encoder: Encoder, texts: Sequence[str] = NEGATIVES, *, threads: int = 0
) -> Negatives:
    """Return the field's own negatives if they are of these texts; otherwise embed and score the texts.

    Raises: MismatchError: the field was written with another encoder. InputError: no texts.
    """
    field.check_encoder(encoder.identity)
    if not texts:
        raise InputError("relevancy needs at least one negative text")
    if field.negatives is not None and field.negatives.texts == tuple(texts):
        return field.negatives
    embeddings = np.asarray(encoder.encode_texts(texts), np.float32)
    return field.score_negatives(embeddings, tuple(texts), threads=threads)


def split_negation(text: str) -> tuple[str, tuple[str, ...]]:
    """Split a text into what is wanted and what is not: "mug, not red", "mug but not red" become ("mug", ("red",)).

    Raises: InputError: nothing before or after a "not".
    """
    wanted, *unwanted = (part.strip() for part in BUT_NOT.split(text))
    if unwanted and not all([wanted, *unwanted]):
        raise InputError(f"{text.strip()!r}: expected words and their exclusions, as in 'mug, not red'")
    return wanted, tuple(unwanted)


def rival_scores(
    field: LanguageField, encoder: Encoder, text: str, unwanted: Sequence[str], *, threads: int = 0
) -> Numbers:
    """Return each row's best score for the text with an unwanted word before it: "red mug" for "mug, not red".

    Raises: InputError: nothing is unwanted. MismatchError: another encoder.
    """
    texts = [f"{word} {text}" for word in unwanted]
    return text_negatives(field, encoder, texts, threads=threads).maxima


def without(scores: Numbers, rivals: Numbers) -> Numbers:
    """Return the scores, UNSELECTED_COSINE where a rival fits as well or better."""
    return np.where(rivals >= scores, np.float32(UNSELECTED_COSINE), scores)


def row_of(field: LanguageField, gaussian_id: int) -> int:
    """Return the row of a Gaussian of the scene. Raises: InputError: it has no feature."""
    row = int(field.rows_of(np.array([gaussian_id]))[0])
    if row < 0:
        raise InputError(f"Gaussian {gaussian_id} has no feature: no mask of any photo covers it")
    return row


def feature_of(field: LanguageField, gaussian_id: int) -> Embedding:
    """Return the unit feature of a Gaussian of the scene. Raises: InputError: it has none."""
    return field.feature(np.array([row_of(field, gaussian_id)]))[0]


def seen_among(
    field: LanguageField,
    splats: SplatArrays,
    ids: OtherIndices | None,
    view: View,
    xy: tuple[float, float],
    *,
    threads: int = 0,
) -> tuple[Indices, Numbers]:
    """Return the rows of the field that a pixel of a view shows, one or more, and their blending weights there.

    splats, ids: of the Gaussians that the view may see, and their rows in the scene; None: they are all of it. xy:
    pixels from the left and from the top; the centre of the first pixel is at (0.5, 0.5).

    Raises: InputError: a pixel outside of the view, or one where no Gaussian has a feature.
    """
    pixel, _ = _pixel_map(view, np.array([xy], np.float64))
    seen = view_weights(splats, view, pixel, topk=None, threads=threads)
    rows = field.rows_of(seen.gaussian_ids if ids is None else ids[seen.gaussian_ids])
    if not (rows >= 0).any():
        raise InputError(
            f"no Gaussian at pixel {xy[0]:g},{xy[1]:g} of view '{view.name}' has a feature: click elsewhere"
        )
    return rows[rows >= 0], seen.weights[rows >= 0]


def pixel_weights(
    splats: SplatArrays, ids: OtherIndices | None, view: View, pixels: DoubleRows, k: int, *, threads: int = 0
) -> PixelWeights:
    """Return the k largest blending weights of some pixels of a view. ids: as of `seen_among`.

    Raises: InputError: k < 1, or a pixel that is outside of the view.
    """
    numbers, order = _pixel_map(view, pixels)
    seen = view_weights(splats, view, numbers, topk=k, threads=threads)
    by_pixel = np.lexsort((-seen.weights, seen.mask_ids))
    masks = seen.mask_ids[by_pixel]
    rank = np.arange(len(masks)) - np.searchsorted(masks, masks)
    found = PixelWeights(np.full((len(pixels), k), -1), np.zeros((len(pixels), k), np.float32))
    rows = seen.gaussian_ids.astype(np.int64)
    found.gaussian_ids[masks, rank] = (rows if ids is None else ids[rows])[by_pixel]
    found.weights[masks, rank] = seen.weights[by_pixel]
    return PixelWeights(found.gaussian_ids[order], found.weights[order])


def _pixel_map(view: View, pixels: DoubleRows) -> tuple[MaskIds, Indices]:
    """Return a map with a number for each of some pixels, -1 elsewhere, and the number of each.

    Raises: InputError: a pixel that is not finite, or outside of the view.
    """
    if not np.isfinite(pixels).all():
        raise InputError(f"expected pixels of two finite numbers, got {pixels.tolist()}")
    outside = ((pixels < 0) | (pixels >= view.size)).any(1)
    if outside.any():
        x, y = pixels[outside][0]
        raise InputError(f"pixel {x:g},{y:g} is outside of view '{view.name}': it has {view.width}x{view.height}")
    columns, rows = np.floor(pixels).astype(np.int64).T
    chosen, order = np.unique(rows * view.width + columns, return_inverse=True)
    numbers = np.full(view.height * view.width, -1, np.int32)
    numbers[chosen] = np.arange(len(chosen))
    return numbers.reshape(view.height, view.width), order
