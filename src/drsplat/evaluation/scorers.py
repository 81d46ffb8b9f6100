"""Methods under test: a text to one number per Gaussian of the scene."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from ..base.arrays import Float32
from ..errors import MismatchError
from ..field import LanguageField, relevancy_from_scores
from ..formats.peer_features import Rows
from ..query import Query, Scene
from ..query.search import NEGATIVES, QUERIES_AT_ONCE, embed_query
from ..query.wholes import by_object, for_comparing
from ..scene.encoders import Encoder
from ..scene.views import pictures_kind, scenes_rendered

BLOCK_ROWS = 1 << 16
COSINE_THRESHOLD, RELEVANCY_THRESHOLD = 0.5, 0.5
# texts and photos have cosines of 0.15 to 0.35 with CLIP, up to 1 with the built-in encoders
COSINE_SWEEP = tuple(k / 100 for k in (*range(14, 36), *range(40, 95, 5)))
RELEVANCY_SWEEP = tuple(k / 100 for k in range(40, 92, 2))

Scores = Float32[np.ndarray, " N"]


@dataclass(frozen=True, eq=False)
class Scorer:
    """Method on one scene.

    scores: of a text, one per Gaussian; NaN where a Gaussian has no feature. name: of the method, in tables. threshold:
    the fixed one, chosen without the scenes that are scored. least: the encoder's own, below which its scores say that
    nothing is meant; None where it has none. sweep: thresholds that the tuned one is chosen from. about: description of
    the method, with hashes. views: names of the photos that it was made from, None if unknown. several: the
    scores of a few texts at once, where that takes less time. answer: what `drsplat select` compares for a text, and
    with which threshold. classes: the scores by which `drsplat segment` compares texts, one after the other; None:
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
        """Yield, for each text, the scores by which classes are compared."""
        return self.each(texts) if self.classes is None else self.classes(texts)

    def each(self, texts: Sequence[str]) -> Iterator[Scores]:
        """Yield the scores of each text."""
        if self.several is None:
            yield from map(self.scores, texts)
            return
        for begin in range(0, len(texts), QUERIES_AT_ONCE):
            yield from self.several(texts[begin : begin + QUERIES_AT_ONCE])


def cosine_scorer(source: LanguageField, encoder: Encoder, name: str = "cosine", *, threads: int = 0) -> Scorer:
    """Score by cosines of the field, or of whole objects if it has any.

    Its threshold is the encoder's own, or 0.5 without one.

    Raises: MismatchError: another encoder than the field's.
    """
    source.check_encoder(encoder.identity)

    def several(texts: Sequence[str]) -> Float32[np.ndarray, "q N"]:
        queries = np.stack([embed_query(encoder, source, text) for text in texts])
        rows = source.scores(queries, threads=threads)
        return np.stack([source.dense(by_object(source, row), fill=float("nan")) for row in rows])

    def scores(text: str) -> Scores:
        row: Scores = several([text])[0]
        return row

    def classes(texts: Sequence[str]) -> Iterator[Scores]:
        for text in texts:
            query = embed_query(encoder, source, text)
            own = source.scores(query, threads=threads)
            yield source.dense(for_comparing(source, own, query), fill=float("nan"))

    about = {
        "field": source.fingerprint,
        "scene": source.scene,
        "encoder": source.encoder.name,
        "registered": len(source),
        "measure": "cosine",
        "pictures": pictures_kind(source.rendered_from),
        "rendered_from": scenes_rendered(source.rendered_from),
    }
    views = None if source.evidence is None else source.evidence.masks.view_names
    return Scorer(
        name, source.num_gaussians, scores, _fixed(encoder), COSINE_SWEEP, about, views, _own(encoder), several,
        _answer(source, encoder, threads), None if source.objects is None else classes,
    )  # fmt: skip


def _answer(source: LanguageField, encoder: Encoder, threads: int) -> Callable[[str], tuple[Scores, float]]:
    scene = Scene(source, encoder=encoder, threads=threads)

    def answer(text: str) -> tuple[Scores, float]:
        reply = scene.ask(Query(text, present=True))  # whoever evaluates asks for what is there
        return source.dense(reply.values, fill=float("nan")), reply.threshold

    return answer


def feature_scorer(features: Rows, encoder: Encoder, name: str = "features") -> Scorer:
    """Score by cosines with features of any system; rows without direction count as absent.

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
    return Scorer(name, len(features), scores, threshold, COSINE_SWEEP, about, least=least)


def relevant(cosines: Scorer, name: str = "relevancy") -> Scorer:
    """Score by LERF's relevancy, from a scorer of cosines; the fixed threshold is 0.5, "as well as a negative".

    The negatives "object", "things", "stuff" and "texture" are scored once, at the first text.

    Source: Kerr et al. 2023 (LERF) Sec. 3.3.
    """

    @cache
    def best_negative() -> Scores:
        return np.asarray(np.max(list(cosines.each(NEGATIVES)), axis=0))

    def scores(text: str) -> Scores:
        return relevancy_from_scores(cosines.scores(text), best_negative())

    def several(texts: Sequence[str]) -> Float32[np.ndarray, "q N"]:
        rows = cosines.each(texts)
        return np.stack([relevancy_from_scores(row, best_negative()) for row in rows])

    about = {**cosines.about, "measure": "relevancy", "negatives": list(NEGATIVES)}
    return replace(
        cosines, name=name, scores=scores, several=several, threshold=RELEVANCY_THRESHOLD, sweep=RELEVANCY_SWEEP,
        about=about, least=None, answer=None,
    )  # fmt: skip


def hashed(array: Rows) -> str:
    """Hash the type, shape and content of an array."""
    digest = hashlib.blake2b(f"{array.dtype.str} {array.shape}".encode(), digest_size=16)
    for start in range(0, len(array), BLOCK_ROWS):
        digest.update(np.ascontiguousarray(array[start : start + BLOCK_ROWS]).data)
    return digest.hexdigest()


def _cosines(features: Rows, unit: Float32[np.ndarray, " D"]) -> Scores:
    scores = np.empty(len(features), np.float32)
    for start in range(0, len(features), BLOCK_ROWS):
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            block = features[start : start + BLOCK_ROWS].astype(np.float32)
            norms = np.linalg.norm(block, axis=1)
            lengths = np.where((norms > 0) & (norms < np.inf), norms, np.nan)
            scores[start : start + BLOCK_ROWS] = block @ unit / lengths
    return scores


def _own(encoder: Encoder) -> float | None:
    return getattr(encoder, "threshold", None)


def _fixed(encoder: Encoder) -> float:
    own = _own(encoder)
    return COSINE_THRESHOLD if own is None else own
