"""A scene in few vectors: enough for its own rules to tell, nearly as its field does, which objects it answers with."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..base.arrays import (
    Arrays,
    ByteRows,
    Embedding,
    Embeddings,
    Flags,
    FloatRows,
    Ids,
    Indices,
    Numbers,
    OtherIds,
    OtherIndices,
    WholeNumbers,
)
from ..errors import FormatError
from ..field import LanguageField
from ..field.codes.code import Best, Hits
from ..field.codes.mixture.scene_atoms import spherical_kmeans
from ..field.labels import same_name
from ..formats.tensors import check_tensors
from ..kernels.mixture import nearest_centres
from ..photos.models.word_list import list_vectors
from ..scene.boxes import HAZE_OPACITY
from ..scene.encoders import Encoder, EncoderIdentity
from .contrast import Contrast, contrast_of, usual_pictures
from .defaults import MIN_GAUSSIANS, RELEVANCY
from .measuring import Background, Measuring
from .objects import objects_of
from .query import Query
from .scene import Scene
from .thresholds import PEAK_ROWS
from .wholes import with_objects

MAX_VECTORS_OF_OBJECT, MAX_LOOSE_VECTORS = 4, 32  # loose: for all Gaussians that belong to no object
MIN_ROWS_PER_VECTOR = 16  # that it is the mean of
SAMPLED_ROWS = 1024  # of an object, spread over all of it, that say which are alike
MAX_PICTURES = 128
MAX_ROWS = 20_000  # that all vectors together stand for; large scenes are thinned
SEED = 0
VECTORS, NUMBERS = ("features", "pictures", "words"), ("counts", "numbers", "solid")
ARRAYS = {
    "features": ("uint8", "f b"), "features_steps": ("float32", "d"), "counts": ("int32", "f"),
    "numbers": ("int32", "f"), "pictures": ("uint8", "p b"), "pictures_steps": ("float32", "d"),
    "words": ("uint8", "w b"), "words_steps": ("float32", "d"), "solid": ("int32", "o"), "labels": ("uint8", "l"),
}  # fmt: skip
LARGEST = 31  # of the numbers
RELEVANCY_ERROR = 0.02  # that values of a sketch are off by: what lies nearer to the threshold is left out


@dataclass(frozen=True, eq=False)
class Packed:
    """Vectors whose numbers are whole numbers from -31 to 31, times a step for each of the D dimensions.

    data: the numbers plus 31. Those of three quarters of a vector are the low six bits of a byte each; those of the
    last quarter lie in the high bits, the lowest two in the first quarter. So whole runs of bytes are unpacked at once.
    """

    data: ByteRows
    steps: Embedding

    @classmethod
    def of(cls, vectors: Embeddings) -> "Packed":
        """Return vectors rounded, the largest number of each dimension 31 or -31."""
        steps = np.maximum(np.abs(vectors).max(0, initial=0) / LARGEST, 1e-12).astype(np.float32)
        numbers = np.round(vectors / steps).astype(np.int8)
        padded = np.pad(numbers + LARGEST, ((0, 0), (0, -numbers.shape[1] % 4))).astype(np.uint8)
        a, b, c, last = np.split(padded, 4, axis=1)
        return cls(np.concatenate([a | last << 6, b | last >> 2 << 6, c | last >> 4 << 6], axis=1), steps)

    def __len__(self) -> int:
        return len(self.data)

    @property
    def dim(self) -> int:
        return len(self.steps)

    @property
    def vectors(self) -> Embeddings:
        low, mid, high = np.split(self.data >> 6, 3, axis=1)
        numbers = np.concatenate([self.data & 63, low | mid << 2 | high << 4], axis=1)[:, : self.dim]
        return np.asarray((numbers.view(np.int8) - np.int8(LARGEST)) * self.steps, np.float32)

    def products(self, queries: Embeddings) -> FloatRows:
        """Return the vectors' inner products with queries, without unpacking them."""
        weights = np.zeros((len(queries), 4 * _quarter(self.dim)), np.float32)
        weights[:, : self.dim] = queries * self.steps
        low, last = weights[:, : -_quarter(self.dim)], weights[:, -_quarter(self.dim) :]
        high = np.concatenate([last, 4 * last, 16 * last], axis=1)
        # Not by BLAS, whose threads would spin for longer than so few products take.
        sums = np.einsum("qb,pb->qp", low, (self.data & 63).astype(np.float32))
        sums += np.einsum("qb,pb->qp", high, (self.data >> 6).astype(np.float32))
        return np.asarray(sums - LARGEST * weights.sum(1, keepdims=True), np.float32)


def _quarter(dim: int) -> int:
    return -(-dim // 4)


@dataclass(frozen=True, eq=False)
class Sketch:
    """Part of a scene's field that is kept to query it by its own rules.

    features: means of rows that are alike, each in place of `counts` rows of the object `numbers`, -1 for none.
    pictures: some of the photos' masks, which say what is usual. words: the list that the field keeps, none where it
    keeps none. solid: per object its Gaussians that can be seen; of fewer than 40 there is no match. labels: the names
    that people gave to objects, by their numbers.
    """

    features: Packed
    counts: Ids
    numbers: Ids
    pictures: Packed
    words: Packed
    solid: OtherIds
    labels: Mapping[int, str]

    @cached_property
    def firsts(self) -> Indices:
        """Per vector the first of the rows that it stands for, if all rows are in its order."""
        return np.asarray(np.cumsum(self.counts) - self.counts, np.int64)

    def to_bytes(self) -> bytes:
        """Return it as a file of safetensors, six bits for each number of a vector."""
        from safetensors.numpy import save

        arrays = {name: getattr(self, name) for name in NUMBERS}
        for name in VECTORS:
            packed = getattr(self, name)
            arrays |= {name: packed.data, f"{name}_steps": packed.steps}
        return bytes(save(arrays | {"labels": np.frombuffer(json.dumps(dict(self.labels)).encode(), np.uint8)}))

    @classmethod
    def from_bytes(cls, data: bytes, dim: int) -> "Sketch":
        """Read what `to_bytes` wrote. Raises: FormatError: something else, or numbers that do not fit each other."""
        from safetensors import SafetensorError
        from safetensors.numpy import load

        try:
            arrays = load(data)
            check_tensors(arrays, ARRAYS, "arrays")
            features, pictures, words = (Packed(arrays[name], arrays[f"{name}_steps"]) for name in VECTORS)
            if (features.dim, features.data.shape[1]) != (dim, 3 * _quarter(dim)):
                raise ValueError(f"expected vectors of {dim} numbers")
            if not all(((one.steps >= 0) & (one.steps <= 1)).all() for one in (features, pictures, words)):
                raise ValueError("expected steps between 0 and 1")
            for vectors in (pictures, words):
                unit(vectors)
            labels = {int(key): label for key, label in json.loads(arrays["labels"].tobytes()).items()}
            if not all(type(label) is str for label in labels.values()):
                raise ValueError("expected labels that are texts")
        except (SafetensorError, FormatError, ValueError, AttributeError, RecursionError) as error:
            raise FormatError(f"no sketch of a scene ({error!s:.200})") from error
        counts, numbers, solid = (arrays[name] for name in NUMBERS)
        most = MAX_ROWS + PEAK_ROWS * counts.size
        if not len(pictures) or (counts < 1).any() or counts.sum(dtype=np.int64) > most:
            raise FormatError("a sketch of a scene whose parts do not fit each other")
        is_known = numbers.min(initial=-1) >= -1 and numbers.max(initial=-1) < len(solid)
        if not is_known or not all(0 <= number < len(solid) for number in labels):
            raise FormatError(f"a sketch of a scene with an object that is not among its {len(solid)}")
        return cls(features, counts, numbers, pictures, words, solid, labels)


def sketch_of(scene: Scene) -> Sketch:
    """Return the sketch of a scene. Raises: InputError: nobody has looked for its objects."""
    field, objects = scene.field, objects_of(scene.field)
    number_of_row = objects.thing_of()
    thinned = max(1.0, len(field) / MAX_ROWS)
    parts = [_summary(field, np.flatnonzero(number_of_row == number), number) for number in range(-1, len(objects))]
    features, counts, numbers = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    fewer = np.minimum(counts, np.maximum(PEAK_ROWS, counts / thinned)).astype(np.int32)
    solid = np.ones(len(field), np.bool_)
    if scene.has_gaussians:
        solid = scene.rows.opacities_of(field.gaussian_ids) >= HAZE_OPACITY
    words = np.empty((0, field.encoder.dim), np.float32) if field.contrast is None else field.contrast.embeddings
    return Sketch(
        Packed.of(features), fewer, numbers, Packed.of(usual_pictures(field, MAX_PICTURES)), Packed.of(words),
        np.bincount(number_of_row[solid] + 1, minlength=len(objects) + 1)[1:].astype(np.int32),
        {match.object_id: match.label for match in scene.objects if match.object_id is not None and match.label},
    )  # fmt: skip


def _summary(field: LanguageField, rows: OtherIndices, number: int) -> tuple[Embeddings, Ids, Ids]:
    """Return the means of some rows that are alike, how many rows each is of, and the number once for each."""
    most = MAX_LOOSE_VECTORS if number < 0 else MAX_VECTORS_OF_OBJECT
    count = int(np.clip(len(rows) // MIN_ROWS_PER_VECTOR, min(1, len(rows)), most))
    features = field.feature(rows)
    nearest = np.zeros(len(rows), np.int32)
    if count > 1:
        spread = features[np.linspace(0, len(rows) - 1, min(len(rows), SAMPLED_ROWS)).astype(np.int64)]
        nearest = nearest_centres(features, spherical_kmeans(spread, count, SEED, threads=1), threads=1)
    groups = [features[nearest == group] for group in np.unique(nearest)]
    means = [group.mean(0, dtype=np.float64) for group in groups]
    vectors = np.array(means, np.float32).reshape(len(groups), field.encoder.dim)
    return vectors, np.array([len(group) for group in groups], np.int32), np.full(len(groups), number, np.int32)


def unit(packed: Packed) -> Embeddings:
    """Return unit vectors that were rounded, of unit length. Raises: ValueError: they are far from unit."""
    vectors = packed.vectors
    lengths = np.sqrt(np.einsum("pd,pd->p", vectors, vectors))
    if (np.abs(lengths - 1) > 0.5).any():
        raise ValueError("vectors that are not of unit length")
    return np.asarray(vectors / lengths[:, None], np.float32)


@dataclass(frozen=True, eq=False)
class _Copies:
    """A code whose rows are copies of a few vectors."""

    packed: Packed
    of_row: Ids
    kind = "copies"

    @property
    def dim(self) -> int:
        return self.packed.dim

    @property
    def nbytes(self) -> int:
        return self.of_row.nbytes

    def __len__(self) -> int:
        return len(self.of_row)

    def scores(self, queries: Embeddings, *, threads: int = 0) -> FloatRows:
        return self.packed.products(queries)[:, self.of_row]

    def select(
        self, query: Embedding, threshold: float, floor: Numbers | None = None,
        *, threads: int = 0,
    ) -> Hits:  # fmt: skip
        scores = self.scores(query[None])[0]
        (rows,) = np.nonzero(scores - (0 if floor is None else floor) > threshold)
        return Hits(rows, scores[rows])

    def top(self, query: Embedding, count: int, *, threads: int = 0) -> Hits:
        scores = self.scores(query[None])[0]
        rows = np.argsort(-scores, kind="stable")[:count]
        return Hits(rows, scores[rows])

    def best(self, queries: Embeddings, *, threads: int = 0) -> Best:
        scores = self.packed.products(queries)
        order = np.sort(np.concatenate([np.full_like(scores[:1], -np.inf), scores]), axis=0)
        index = scores.argmax(0).astype(np.int32)
        return Best(index[self.of_row], order[-1][self.of_row], order[-2][self.of_row])

    def decode(self, rows: WholeNumbers) -> Embeddings:
        return self.packed.vectors[self.of_row[rows]]

    def rows(self, index: WholeNumbers) -> "_Copies":
        return _Copies(self.packed, self.of_row[index])

    def run(self, begin: int, end: int) -> "_Copies":
        return _Copies(self.packed, self.of_row[begin:end])

    def tensors(self) -> Arrays:
        return {"data": self.packed.data, "steps": self.packed.steps, "of_row": self.of_row}


@dataclass(frozen=True, eq=False, kw_only=True)
class _Sketched(Background):
    """A background that does once for each vector of the sketch what others do for each Gaussian."""

    sketch: Sketch

    def by_object(self, field: LanguageField, values: Numbers) -> Numbers:
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

    def contrast_of_kind(self, vectors: Embeddings) -> Contrast:
        return self._of_list(vectors, of_kind=True)

    def _of_list(self, words: Embeddings, *, of_kind: bool = False) -> Contrast:
        sketch = self.sketch
        known = contrast_of(sketch.features.vectors, words, pictures=unit(sketch.pictures), of_kind=of_kind)
        return replace(known, counts=sketch.counts)


class SketchedScene:
    """A sketch that is asked, with a scene's own rules.

    Args: source: makes the encoder of queries.
    """

    def __init__(self, sketch: Sketch, encoder: EncoderIdentity, source: Callable[[], Encoder]) -> None:
        self._sketch = sketch
        # A field with copies of the sketch's vectors as its features; of its objects the sketch tells
        of_row = np.repeat(np.arange(len(sketch.counts), dtype=np.int32), sketch.counts)
        field = LanguageField(
            np.arange(len(of_row), dtype=np.uint32),
            _Copies(sketch.features, of_row),
            encoder,
            scene="",
            num_gaussians=len(of_row),
        )
        self._background = _Sketched(
            field.with_contrast(unit(sketch.words), ("",) * len(sketch.words)) if len(sketch.words) else field,
            source,
            threads=1,
            sketch=sketch,
        )

    def answers(self, query: Query) -> Flags:
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
