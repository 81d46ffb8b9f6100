"""What a protocol asks: a text, and one number per Gaussian of the scene."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from ..arrays import Float32
from ..encoders import Encoder
from ..errors import MismatchError
from ..field import LanguageField, relevancy_from_scores
from ..formats.peer_features import Rows
from ..query import Scene
from ..query.search import CHUNK, NEGATIVES, embed_query
from ..query.wholes import by_object, for_comparing
from ..scene.views import pictures_kind, scenes_rendered

BLOCK = 1 << 16
COSINE_THRESHOLD, RELEVANCY_THRESHOLD = 0.5, 0.5
# of CLIP, texts and photos are at cosines of 0.15 to 0.35; of the built-in encoders up to 1
COSINES = tuple(k / 100 for k in (*range(14, 36), *range(40, 95, 5)))
RELEVANCIES = tuple(k / 100 for k in range(40, 92, 2))

Scores = Float32[np.ndarray, " N"]


@dataclass(frozen=True, eq=False)
class Scorer:
    """A method on one scene.

    scores: of a text, one per Gaussian; NaN where a Gaussian has no feature. name: of the method, in tables. threshold:
    the fixed one, chosen without the scenes that are scored. least: the encoder's own, below which its scores say that
    nothing is meant; None where it has none. sweep: thresholds that the tuned one is chosen from. about: what it is
    made of, hashes among it. views: names of the photos that it was made from, None where nobody knows. several: the
    scores of a few texts at once, where that takes less time. answer: what `drsplat select` compares for a text, and
    with which threshold. classes: of some texts in turn the scores by which `drsplat segment` compares them; None:
    `scores`.
    """

    name: str
    num_gaussians: int
    scores: Callable[[str], Scores]
    threshold: float
    sweep: tuple[float, ...]
    about: Mapping[str, object] = field(default_factory=dict)
    views: tuple[str, ...] | None = None
    least: float | None = None
    several: Callable[[Sequence[str]], Float32[np.ndarray, "q N"]] | None = None
    answer: Callable[[str], tuple[Scores, float]] | None = None
    classes: Callable[[Sequence[str]], Iterator[Scores]] | None = None

    def compared(self, texts: Sequence[str]) -> Iterator[Scores]:
        """Of each text in turn the scores by which one class is better than another."""
        return self.each(texts) if self.classes is None else self.classes(texts)

    def each(self, texts: Sequence[str]) -> Iterator[Scores]:
        """The scores of each text in turn."""
        if self.several is None:
            yield from map(self.scores, texts)
            return
        for begin in range(0, len(texts), CHUNK):
            yield from self.several(texts[begin : begin + CHUNK])


def cosine_scorer(known: LanguageField, encoder: Encoder, name: str = "cosine", *, threads: int = 0) -> Scorer:
    """Cosines of the field; of one with objects, as whole ones. threshold: the encoder's own, or 0.5 without one.

    Raises: MismatchError: another encoder than the field's.
    """
    known.check_encoder(encoder.identity)

    def several(texts: Sequence[str]) -> Float32[np.ndarray, "q N"]:
        queries = np.stack([embed_query(encoder, known, text) for text in texts])
        each = known.scores(queries, threads=threads)
        return np.stack([known.dense(by_object(known, one), fill=float("nan")) for one in each])

    def scores(text: str) -> Scores:
        one: Scores = several([text])[0]
        return one

    def classes(texts: Sequence[str]) -> Iterator[Scores]:
        for text in texts:
            query = embed_query(encoder, known, text)
            own = known.scores(query, threads=threads)
            yield known.dense(for_comparing(known, own, query), fill=float("nan"))

    about = {
        "field": known.fingerprint,
        "scene": known.scene,
        "encoder": known.encoder.name,
        "registered": len(known),
        "measure": "cosine",
        "pictures": pictures_kind(known.rendered_from),
        "rendered_from": scenes_rendered(known.rendered_from),
    }
    views = None if known.evidence is None else known.evidence.masks.view_names
    return Scorer(
        name, known.num_gaussians, scores, _fixed(encoder), COSINES, about, views, _own(encoder), several,
        _answer(known, encoder, threads), None if known.objects is None else classes,
    )  # fmt: skip


def _answer(known: LanguageField, encoder: Encoder, threads: int) -> Callable[[str], tuple[Scores, float]]:
    scene = Scene(known, encoder=encoder, threads=threads)

    def answer(text: str) -> tuple[Scores, float]:
        found = scene.ask(text)
        return known.dense(found.values, fill=float("nan")), found.threshold

    return answer


def feature_scorer(features: Rows, encoder: Encoder, name: str = "features") -> Scorer:
    """Cosines with features made by any system; rows without direction are absent.

    features: (N, D) of float16 or float32, of any length, may be a memory map: read a block at a time.

    Raises: MismatchError: features and texts of different dimensions.
    """
    if features.shape[1] != encoder.identity.dim:
        raise MismatchError(
            f"features: expected (N, {encoder.identity.dim}) as the texts have it, got {features.shape}"
        )

    def scores(text: str) -> Scores:
        return _cosines(features, np.asarray(encoder.encode_texts([text])[0], np.float32))

    about = {"features": hashed(features), "encoder": encoder.identity.name, "measure": "cosine"}
    threshold, least = _fixed(encoder), _own(encoder)
    return Scorer(name, len(features), scores, threshold, COSINES, about, least=least)


def relevant(cosines: Scorer, name: str = "relevancy") -> Scorer:
    """LERF's relevancy of any scorer of cosines; its fixed threshold is 0.5, "as well as a negative".

    The negatives "object", "things", "stuff" and "texture" are scored once, at the first text.

    Source: Kerr et al. 2023 (LERF) Sec. 3.3.
    """

    @cache
    def best_negative() -> Scores:
        return np.asarray(np.max(list(cosines.each(NEGATIVES)), axis=0))

    def scores(text: str) -> Scores:
        return relevancy_from_scores(cosines.scores(text), best_negative())

    def several(texts: Sequence[str]) -> Float32[np.ndarray, "q N"]:
        found = cosines.each(texts)
        return np.stack([relevancy_from_scores(one, best_negative()) for one in found])

    about = {**cosines.about, "measure": "relevancy", "negatives": list(NEGATIVES)}
    return replace(
        cosines, name=name, scores=scores, several=several, threshold=RELEVANCY_THRESHOLD, sweep=RELEVANCIES,
        about=about, least=None, answer=None,
    )  # fmt: skip


def hashed(array: Rows) -> str:
    """Of type, shape and content."""
    digest = hashlib.blake2b(f"{array.dtype.str} {array.shape}".encode(), digest_size=16)
    for start in range(0, len(array), BLOCK):
        digest.update(np.ascontiguousarray(array[start : start + BLOCK]).data)
    return digest.hexdigest()


def _cosines(features: Rows, unit: Float32[np.ndarray, " D"]) -> Scores:
    scores = np.empty(len(features), np.float32)
    for start in range(0, len(features), BLOCK):
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            block = features[start : start + BLOCK].astype(np.float32)
            norms = np.linalg.norm(block, axis=1)
            lengths = np.where((norms > 0) & (norms < np.inf), norms, np.nan)
            scores[start : start + BLOCK] = block @ unit / lengths
    return scores


def _own(encoder: Encoder) -> float | None:
    return getattr(encoder, "threshold", None)


def _fixed(encoder: Encoder) -> float:
    own = _own(encoder)
    return COSINE_THRESHOLD if own is None else own
