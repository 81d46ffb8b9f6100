"""Methods under test, which give a text one number per Gaussian of the scene, and metrics of the protocols.

Metrics are pure functions of arrays. Labels are 1 to C; 0 is "none" in a prediction and "not counted" in the truth.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from ..base.arrays import Array, Bool, Float32, Float64, FloatRows, Integer, Real
from ..base.contents import Document
from ..errors import MismatchError
from ..field import LanguageField, relevancy_from_scores
from ..formats.peer_features import Rows
from ..query import Query, Scene
from ..query.search import NEGATIVES, QUERIES_AT_ONCE, embed_query
from ..query.wholes import by_object, for_comparing
from ..scene.encoders import Encoder
from ..scene.views import pictures_kind, scenes_rendered

Labels = Integer[np.ndarray, " n"]
PerClass = Float64[np.ndarray, " c"]
Numbers = Sequence[float | int] | Real[np.ndarray, " n"]
NUM_RESAMPLINGS = 2000


def mask_iou(predicted: Bool[Array, "*n"], truth: Bool[Array, "*n"]) -> float:
    """Return the intersection over union; 0 where both masks are empty.

    >>> mask_iou(np.array([True, True, False, False]), np.array([False, True, True, False]))
    0.3333333333333333
    >>> mask_iou(np.zeros(3, bool), np.zeros(3, bool))
    0.0

    Source: OpenGaussian's evaluation of 3D object selection.
    """
    union = int((predicted | truth).sum())
    return int((predicted & truth).sum()) / union if union else 0.0


def share_above(ious: Numbers, threshold: float) -> float:
    """Return Acc@threshold: the share of IoUs that are strictly greater; NaN for an empty list.

    >>> share_above([0.2, 0.25, 0.26, 0.9], 0.25)
    0.5
    """
    return mean([float(iou > threshold) for iou in ious])


def mean(values: Numbers) -> float:
    """Return the mean; NaN for an empty list, without a warning.

    >>> mean([0.0, 1.0]), mean([])
    (0.5, nan)
    """
    return float(np.mean(np.asarray(values, np.float64))) if len(values) else float("nan")


def scene_macro(by_scene: Sequence[Numbers]) -> float:
    """Return the mean over scenes of the mean within each, so that all scenes count alike.

    >>> scene_macro([[1.0], [0.0, 0.0, 0.5]])
    0.5833333333333334
    """
    return mean([mean(values) for values in by_scene])


def summary(by_scene: Mapping[str, list[Any]], numbers: Callable[[list[Any]], dict[str, float]]) -> Document:
    """Return the numbers of each scene's answers, the means over scenes, and the numbers of all answers together."""
    records = {name: numbers(answers) for name, answers in by_scene.items()}
    pooled = numbers([answer for answers in by_scene.values() for answer in answers])
    macro = {key: mean([record[key] for record in records.values()]) for key in pooled}
    return {"scene_macro": macro, "query_micro": pooled, "by_scene": records}


def class_overlaps(
    predicted: Labels, truth: Labels, num_classes: int, weights: Real[Array, " n"] | None = None
) -> tuple[PerClass, PerClass, PerClass]:
    """Return, per class, the weight of the intersection, of the prediction and of the truth.

    Rows without truth (0) are left out of all three.

    >>> class_overlaps(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 2)
    (array([1., 1.]), array([1., 2.]), array([2., 1.]))
    """
    counted = truth > 0
    predicted, truth = predicted[counted], truth[counted]
    mass = np.ones(len(truth)) if weights is None else weights[counted].astype(np.float64)
    parts = (
        np.bincount(labels[rows], mass[rows], num_classes + 1)[1 : num_classes + 1].astype(float)
        for labels, rows in ((truth, predicted == truth), (predicted, slice(None)), (truth, slice(None)))
    )
    both, of_prediction, of_truth = parts
    return both, of_prediction, of_truth


def class_ious(
    predicted: Labels, truth: Labels, num_classes: int, weights: Real[Array, " n"] | None = None
) -> PerClass:
    """Return the IoU of each class (Eq. 3 with weights); NaN for classes that the truth lacks.

    >>> class_ious(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 3)
    array([0.5, 0.5, nan])
    >>> class_ious(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 3, np.array([3, 1, 1, 9]))
    array([0.75, 0.5 ,  nan])

    Source: Dr. Splat Eq. 3; with equal weights, OpenGaussian's evaluation on ScanNet.
    """
    both, of_prediction, of_truth = class_overlaps(predicted, truth, num_classes, weights)
    return _ratio(both, of_prediction + of_truth - both, of_truth > 0)


def class_accuracies(
    predicted: Labels, truth: Labels, num_classes: int, weights: Real[Array, " n"] | None = None
) -> PerClass:
    """Return the share of each class that is predicted as it; NaN for classes that the truth lacks.

    >>> class_accuracies(np.array([1, 2, 2, 1]), np.array([1, 1, 2, 0]), 3)
    array([0.5, 1. , nan])
    """
    both, _, of_truth = class_overlaps(predicted, truth, num_classes, weights)
    return _ratio(both, of_truth, of_truth > 0)


def mean_present(values: PerClass) -> float:
    """Return the mean over the classes that are present (not NaN).

    >>> mean_present(np.array([0.5, np.nan, 1.0]))
    0.75
    """
    return mean(values[~np.isnan(values)])


def in_any_box(x: float | int, y: float | int, boxes: Sequence[Numbers]) -> bool:
    """Return whether a point lies in or on one of the boxes (x1, y1, x2, y2).

    >>> in_any_box(3, 4, [[0, 0, 1, 1], [3, 2, 5, 4]]), in_any_box(3, 4.5, [[3, 2, 5, 4]])
    (True, False)
    """
    return any(x1 <= x <= x2 and y1 <= y <= y2 for x1, y1, x2, y2 in boxes)


def pearson(a: Numbers, b: Numbers) -> float:
    """Return the correlation of two lists; NaN where one of them is constant.

    >>> round(pearson([1, 2, 3], [2, 4, 7]), 4), pearson([1, 2], [3, 3])
    (0.9934, nan)
    """
    x, y = (np.asarray(values, np.float64) - np.mean(values) for values in (a, b))
    scale = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / scale if scale > 0 else float("nan")


def spearman(a: Numbers, b: Numbers) -> float:
    """Return the correlation of the ranks; equal values share the mean of their ranks.

    >>> spearman([1, 2, 3, 4], [1, 8, 27, 64]), spearman([1, 2, 2], [1, 1, 3])
    (1.0, 0.5)
    """
    from scipy.stats import rankdata

    return pearson(rankdata(a), rankdata(b))


def mean_interval(values: Numbers, level: float = 0.95) -> tuple[float, float]:
    """Return a bootstrap interval of the mean over scenes: quantiles of means of resampled scenes.

    It is NaN for fewer than two: one scene says nothing about others.

    >>> mean_interval([0.5, 0.5, 0.5])
    (0.5, 0.5)
    """
    if len(values) < 2:
        return float("nan"), float("nan")
    drawn = np.random.default_rng(0).integers(0, len(values), (NUM_RESAMPLINGS, len(values)))
    means = np.asarray(values, np.float64)[drawn].mean(1)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _ratio(part: PerClass, whole: PerClass, present: Bool[Array, " c"]) -> PerClass:
    return np.divide(part, whole, out=np.full(len(part), np.nan), where=present)


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
    several: Callable[[Sequence[str]], Float32[Array, "q N"]] | None = None
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

    def several(texts: Sequence[str]) -> FloatRows:
        queries = np.stack([embed_query(encoder, source, text) for text in texts])
        rows = source.scores(queries, threads=threads)
        return np.stack([source.dense(by_object(source, row), fill=float("nan")) for row in rows])

    def scores(text: str) -> Scores:
        return several([text])[0]

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
    threshold, least = _thresholds(encoder)
    return Scorer(
        name, source.num_gaussians, scores, threshold, COSINE_SWEEP, about, views, least, several,
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
        unit = np.asarray(encoder.encode_texts([text])[0], np.float32)
        scores = np.empty(len(features), np.float32)
        for start in range(0, len(features), BLOCK_ROWS):
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
                block = features[start : start + BLOCK_ROWS].astype(np.float32)
                norms = np.linalg.norm(block, axis=1)
                lengths = np.where((norms > 0) & (norms < np.inf), norms, np.nan)
                scores[start : start + BLOCK_ROWS] = block @ unit / lengths
        return scores

    about = {"features": hashed(features), "encoder": encoder.identity.name, "measure": "cosine"}
    threshold, least = _thresholds(encoder)
    return Scorer(name, len(features), scores, threshold, COSINE_SWEEP, about, least=least)


def relevant(cosines: Scorer, name: str = "relevancy") -> Scorer:
    """Score by LERF's relevancy, from a scorer of cosines; the fixed threshold is 0.5, "as well as a negative".

    The negatives "object", "things", "stuff" and "texture" are scored once, at the first text.

    Source: Kerr et al. 2023 (LERF) Sec. 3.3.
    """

    @cache
    def best_negative() -> Scores:
        return np.max(list(cosines.each(NEGATIVES)), axis=0)

    def scores(text: str) -> Scores:
        return relevancy_from_scores(cosines.scores(text), best_negative())

    def several(texts: Sequence[str]) -> FloatRows:
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


def _thresholds(encoder: Encoder) -> tuple[float, float | None]:
    """Return the fixed threshold and the encoder's own."""
    own = getattr(encoder, "threshold", None)
    return COSINE_THRESHOLD if own is None else own, own
