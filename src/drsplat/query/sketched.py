"""A scene's sketch is queried by the scene's own rules."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..base.arrays import Bool, Float32, Int32, Integer
from ..field import LanguageField
from ..field.codes.code import Best, Hits
from ..field.labels import same_name
from ..photos.models.word_list import list_vectors
from ..scene.encoders import Encoder, EncoderIdentity
from .contrast import Contrast, contrast_of
from .defaults import MIN_GAUSSIANS, RELEVANCY
from .measuring import Background, Measuring
from .packed import Packed
from .query import Query
from .sketch import Sketch, unit
from .wholes import with_objects

RELEVANCY_ERROR = 0.02  # that values of a sketch are off by: what lies nearer to the threshold is left out


@dataclass(frozen=True, eq=False)
class _Copies:
    """A code whose rows are copies of a few vectors."""

    packed: Packed
    of_row: Int32[np.ndarray, " n"]
    kind = "copies"

    @property
    def dim(self) -> int:
        return self.packed.dim

    @property
    def nbytes(self) -> int:
        return self.of_row.nbytes

    def __len__(self) -> int:
        return len(self.of_row)

    def scores(self, queries: Float32[np.ndarray, "q D"], *, threads: int = 0) -> Float32[np.ndarray, "q n"]:
        return np.asarray(self.packed.products(queries)[:, self.of_row])

    def select(
        self, query: Float32[np.ndarray, " D"], threshold: float, floor: Float32[np.ndarray, " n"] | None = None,
        *, threads: int = 0,
    ) -> Hits:  # fmt: skip
        scores = self.scores(query[None])[0]
        (rows,) = np.nonzero(scores - (0 if floor is None else floor) > threshold)
        return Hits(rows, scores[rows])

    def top(self, query: Float32[np.ndarray, " D"], count: int, *, threads: int = 0) -> Hits:
        scores = self.scores(query[None])[0]
        rows = np.argsort(-scores, kind="stable")[:count]
        return Hits(rows, scores[rows])

    def best(self, queries: Float32[np.ndarray, "q D"], *, threads: int = 0) -> Best:
        scores = self.packed.products(queries)
        order = np.sort(np.concatenate([np.full_like(scores[:1], -np.inf), scores]), axis=0)
        index = scores.argmax(axis=0).astype(np.int32)
        return Best(index[self.of_row], order[-1][self.of_row], order[-2][self.of_row])

    def decode(self, rows: Integer[np.ndarray, " b"]) -> Float32[np.ndarray, "b D"]:
        return np.asarray(self.packed.vectors[self.of_row[rows]])

    def rows(self, index: Integer[np.ndarray, " b"]) -> "_Copies":
        return _Copies(self.packed, self.of_row[index])

    def run(self, begin: int, end: int) -> "_Copies":
        return _Copies(self.packed, self.of_row[begin:end])

    def tensors(self) -> dict[str, np.ndarray]:
        return {"data": self.packed.data, "steps": self.packed.steps, "of_row": self.of_row}


@dataclass(frozen=True, eq=False, kw_only=True)
class _Sketched(Background):
    """A background that does once for each vector of the sketch what others do for each Gaussian."""

    sketch: Sketch

    def by_object(self, field: LanguageField, values: Float32[np.ndarray, " r"]) -> Float32[np.ndarray, " r"]:
        """Return values as whole objects have them if the field is `field`, and themselves if it is `plain`."""
        if field is not self.field:
            return values
        counts, numbers = self.sketch.counts, self.sketch.numbers
        no_pieces = np.full(len(numbers), -1, np.int32)
        return np.repeat(with_objects(values[self.sketch.firsts], numbers, no_pieces, counts), counts)

    @cached_property
    def contrast(self) -> Contrast | None:
        vectors = list_vectors(self.encoder)
        return self._of_list(vectors) if len(vectors) else None

    @cached_property
    def kept_contrast(self) -> Contrast | None:
        kept = self.field.contrast
        return None if kept is None else self._of_list(kept.embeddings)

    def contrast_of_kind(self, vectors: Float32[np.ndarray, "n D"]) -> Contrast:
        return self._of_list(vectors, of_kind=True)

    def _of_list(self, words: Float32[np.ndarray, "n D"], *, of_kind: bool = False) -> Contrast:
        sketch = self.sketch
        known = contrast_of(sketch.features.vectors, words, pictures=unit(sketch.pictures), of_kind=of_kind)
        return replace(known, counts=sketch.counts)


class SketchedScene:
    """A sketch that is asked, with a scene's own rules.

    Args: source: makes the encoder of queries.
    """

    def __init__(self, sketch: Sketch, encoder: EncoderIdentity, source: Callable[[], Encoder]) -> None:
        self._sketch = sketch
        self._background = _Sketched(_field_of(sketch, encoder), source, threads=1, sketch=sketch)

    def answers(self, query: Query) -> Bool[np.ndarray, " o"]:
        """Return for each object whether the scene answers a text, a vector or a picture with it.

        Raises: as `Scene.ask`.
        """
        sketch, result = self._sketch, np.zeros(len(self._sketch.solid), np.bool_)
        if query.text is not None and query.is_default and not query.exclude:
            named = [number for number, label in sketch.labels.items() if same_name(label, query.text)]
            if named:
                result[named] = True
                return result
        answer = Measuring(self._background, query, query.exclude).of(query).without_maybe()
        least = answer.threshold + (RELEVANCY_ERROR if answer.measure == RELEVANCY else 0.0)
        numbers = sketch.numbers[answer.values[sketch.firsts] > least]
        result[numbers[numbers >= 0]] = True
        return result & (sketch.solid >= MIN_GAUSSIANS)


def _field_of(sketch: Sketch, encoder: EncoderIdentity) -> LanguageField:
    """Return a field with copies of the sketch's vectors as its features; of its objects the sketch tells."""
    of_row = np.repeat(np.arange(len(sketch.counts), dtype=np.int32), sketch.counts)
    field = LanguageField(
        np.arange(len(of_row), dtype=np.uint32),
        _Copies(sketch.features, of_row),
        encoder,
        scene="",
        num_gaussians=len(of_row),
    )
    return field.with_contrast(unit(sketch.words), ("",) * len(sketch.words)) if len(sketch.words) else field
