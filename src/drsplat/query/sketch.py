"""A scene in few vectors: enough for its own rules to tell, nearly as its field does, which objects it answers with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..base.arrays import Float32, Int8, Int32, Int64, Integer, UInt8
from ..errors import FormatError
from ..field import LanguageField
from ..field.codes.code import Best, Hits
from ..field.codes.mixture.scene_atoms import spherical_kmeans
from ..field.evidence.evidence import Evidence, MaskIds
from ..field.forest import THING, Objects
from ..field.labels import same_name
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

MAX_VECTORS_OF_OBJECT, MAX_LOOSE_VECTORS = 4, 32  # loose: for all Gaussians that belong to no object
MIN_ROWS_PER_VECTOR = 16  # that it is the mean of
SAMPLED_ROWS = 1024  # of an object, spread over all of it, that say which are alike
MAX_PICTURES = 128
MAX_ROWS = 20_000  # that all vectors together stand for; large scenes are thinned
SEED = 0
LARGEST = 31  # of a vector's numbers in a file: six bits
RELEVANCY_ERROR = 0.02  # that values of a sketch are off by: what lies nearer to the threshold is left out
VECTORS, NUMBERS = ("features", "pictures", "words"), ("counts", "numbers", "solid")


@dataclass(frozen=True, eq=False)
class Sketch:
    """Part of a scene's field that is kept to query it by its own rules.

    features: means of rows that are alike, each in place of `counts` rows of the object `numbers`, -1 for none.
    pictures: some of the photos' masks, which say what is usual. words: the list that the field keeps, none where it
    keeps none. solid: per object its Gaussians that can be seen; of fewer than 40 there is no match.
    """

    features: Float32[np.ndarray, "p D"]
    counts: Int32[np.ndarray, " p"]
    numbers: Int32[np.ndarray, " p"]
    pictures: Float32[np.ndarray, "s D"]
    words: Float32[np.ndarray, "n D"]
    solid: Int32[np.ndarray, " o"]

    def to_bytes(self) -> bytes:
        """Return it as a file of safetensors, six bits for each number of a vector."""
        from safetensors.numpy import save

        arrays = {name: getattr(self, name) for name in NUMBERS}
        for name in VECTORS:
            vectors = getattr(self, name)
            steps = np.maximum(np.abs(vectors).max(axis=0, initial=0) / LARGEST, 1e-12).astype(np.float32)
            arrays |= {name: _packed(np.round(vectors / steps).astype(np.int8)), f"{name}_steps": steps}
        return bytes(save(arrays))

    @classmethod
    def from_bytes(cls, data: bytes, dim: int, num_objects: int) -> "Sketch":
        """Read what `to_bytes` wrote. Raises: FormatError: something else, or numbers that do not fit each other."""
        from safetensors import SafetensorError
        from safetensors.numpy import load

        try:
            arrays = load(data)
            numbers = {name: arrays[name].astype(np.int32, casting="safe") for name in NUMBERS}
            vectors = {name: _vectors(arrays[name], arrays[f"{name}_steps"], dim) for name in VECTORS}
            vectors |= {name: _unit(vectors[name]) for name in ("pictures", "words")}
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise FormatError(f"no sketch of a scene ({error!s:.200})") from error
        _check(num_objects=num_objects, features=vectors["features"], pictures=vectors["pictures"], **numbers)
        return cls(**vectors, **numbers)


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
    return Sketch(
        features, fewer, numbers, usual_pictures(field, MAX_PICTURES),
        np.empty((0, field.encoder.dim), np.float32) if field.contrast is None else field.contrast.embeddings,
        np.bincount(number_of_row[solid] + 1, minlength=len(objects) + 1)[1:].astype(np.int32),
    )  # fmt: skip


def _summary(
    field: LanguageField, rows: Int64[np.ndarray, " r"], number: int
) -> tuple[Float32[np.ndarray, "p D"], Int32[np.ndarray, " p"], Int32[np.ndarray, " p"]]:
    """Return the means of some rows that are alike, how many rows each is of, and the number once for each."""
    most = MAX_LOOSE_VECTORS if number < 0 else MAX_VECTORS_OF_OBJECT
    count = int(np.clip(len(rows) // MIN_ROWS_PER_VECTOR, min(1, len(rows)), most))
    features = field.feature(rows)
    nearest = np.zeros(len(rows), np.int32)
    if count > 1:
        spread = features[np.linspace(0, len(rows) - 1, min(len(rows), SAMPLED_ROWS)).astype(np.int64)]
        nearest = nearest_centres(features, spherical_kmeans(spread, count, SEED, threads=1), threads=1)
    groups = [features[nearest == group] for group in np.unique(nearest)]
    means = [group.mean(axis=0, dtype=np.float64) for group in groups]
    vectors = np.array(means, np.float32).reshape(len(groups), field.encoder.dim)
    return vectors, np.array([len(group) for group in groups], np.int32), np.full(len(groups), number, np.int32)


def _packed(numbers: Int8[np.ndarray, "p D"]) -> UInt8[np.ndarray, "p b"]:
    """Return numbers from -31 to 31 in six bits each, four of a row in three bytes."""
    padded = np.pad(numbers + LARGEST, ((0, 0), (0, -numbers.shape[1] % 4))).astype(np.uint8)
    a, b, c, d = (padded[:, at::4] for at in range(4))
    return np.stack([a << 2 | b >> 4, b << 4 | c >> 2, c << 6 | d], axis=2).reshape(len(numbers), 3 * a.shape[1])


def _unpacked(data: UInt8[np.ndarray, "p b"], dim: int) -> Int8[np.ndarray, "p D"]:
    """Return what `_packed` packed."""
    a, b, c = (data[:, at::3] for at in range(3))
    numbers = np.stack([a >> 2, (a << 4 | b >> 4) & 63, (b << 2 | c >> 6) & 63, c & 63], axis=2)
    return numbers.reshape(len(data), 4 * a.shape[1])[:, :dim].astype(np.int8) - np.int8(LARGEST)


def _vectors(data: UInt8[np.ndarray, "p b"], steps: Float32[np.ndarray, " D"], dim: int) -> Float32[np.ndarray, "p D"]:
    """Return vectors that were packed. Raises: ValueError: other shapes or steps than they have."""
    expected = -(-dim // 4) * 3
    if data.dtype != np.uint8 or steps.dtype != np.float32 or data.shape[1:] != (expected,) or steps.shape != (dim,):
        raise ValueError(f"expected vectors of {expected} bytes, got {data.dtype} {data.shape}")
    if not ((steps >= 0) & (steps <= 1)).all():
        raise ValueError("expected steps between 0 and 1")
    return np.asarray(_unpacked(data, dim) * steps, np.float32)


def _unit(vectors: Float32[np.ndarray, "p D"]) -> Float32[np.ndarray, "p D"]:
    """Bring rounded unit vectors back to unit length. Raises: ValueError: they are far from unit."""
    lengths = np.sqrt(np.einsum("pd,pd->p", vectors, vectors))
    if (np.abs(lengths - 1) > 0.5).any():
        raise ValueError("vectors that are not of unit length")
    return np.asarray(vectors / lengths[:, None], np.float32)


def _check(
    num_objects: int, features: np.ndarray, pictures: np.ndarray, counts: np.ndarray, numbers: np.ndarray,
    solid: np.ndarray,
) -> None:  # fmt: skip
    """Check a sketch. Raises: FormatError: numbers that do not fit each other, or more rows than sketches have."""
    fits = counts.shape == numbers.shape == features.shape[:1] and solid.shape == (num_objects,)
    most = MAX_ROWS + PEAK_ROWS * counts.size
    if not fits or not len(pictures) or (counts < 1).any() or counts.sum(dtype=np.int64) > most:
        raise FormatError("a sketch of a scene whose parts do not fit each other")
    if len(numbers) and not -1 <= numbers.min() <= numbers.max() < num_objects:
        raise FormatError(f"a sketch of a scene with an object that is not among its {num_objects}")


@dataclass(frozen=True, eq=False)
class _Copies:
    """A code whose rows are copies of a few vectors."""

    vectors: Float32[np.ndarray, "p D"]
    of_row: Int64[np.ndarray, " n"]
    kind = "copies"

    @property
    def dim(self) -> int:
        return int(self.vectors.shape[1])

    @property
    def nbytes(self) -> int:
        return self.of_row.nbytes

    def __len__(self) -> int:
        return len(self.of_row)

    def scores(self, queries: Float32[np.ndarray, "q D"], *, threads: int = 0) -> Float32[np.ndarray, "q n"]:
        # Not by BLAS, whose threads would spin for longer than so few products take.
        return np.asarray(np.einsum("qd,pd->qp", queries, self.vectors)[:, self.of_row], np.float32)

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
        scores = queries @ self.vectors.T
        order = np.sort(np.concatenate([np.full_like(scores[:1], -np.inf), scores]), axis=0)
        index = scores.argmax(axis=0).astype(np.int32)
        return Best(index[self.of_row], order[-1][self.of_row], order[-2][self.of_row])

    def decode(self, rows: Integer[np.ndarray, " b"]) -> Float32[np.ndarray, "b D"]:
        return np.asarray(self.vectors[self.of_row[rows]])

    def rows(self, index: Integer[np.ndarray, " b"]) -> "_Copies":
        return _Copies(self.vectors, self.of_row[index])

    def run(self, begin: int, end: int) -> "_Copies":
        return _Copies(self.vectors, self.of_row[begin:end])

    def tensors(self) -> dict[str, np.ndarray]:
        return {"vectors": self.vectors, "of_row": self.of_row}


class _Usual(Background):
    """A background whose list of words is scored once for each vector of the sketch, and not for each of its copies."""

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
        code, evidence = self.field.code, self.field.evidence
        assert isinstance(code, _Copies)
        assert evidence is not None
        known = contrast_of(evidence.embeddings, words, of_kind=of_kind).at(code.vectors)
        return replace(known, scores=known.scores[code.of_row], words=known.words[code.of_row])


class SketchedScene:
    """A sketch that is asked, with a scene's own rules.

    Args: labels: the names that people gave to objects, None for none. source: makes the encoder of queries.
    """

    def __init__(
        self, sketch: Sketch, labels: Sequence[str | None], encoder: EncoderIdentity, source: Callable[[], Encoder]
    ) -> None:
        self._solid, self._labels = sketch.solid, labels
        self._background = _Usual(_field_of(sketch, encoder), source, threads=1)

    def answers(self, query: Query) -> Int64[np.ndarray, " a"]:
        """Return the numbers of the objects that the scene answers a text, a vector or a picture with, ascending.

        Raises: as `Scene.ask`.
        """
        if query.text is not None and query.is_default and not query.exclude:
            named = [at for at, label in enumerate(self._labels) if label is not None and same_name(label, query.text)]
            if named:
                return np.array(named)
        answer = Measuring(self._background, query, query.exclude).of(query)
        least = answer.threshold + (RELEVANCY_ERROR if answer.measure == RELEVANCY else 0.0)
        things = objects_of(self._background.field).thing_of()[answer.values > least]
        numbers = np.flatnonzero(np.bincount(things + 1, minlength=1)[1:])
        return np.asarray(numbers[self._solid[numbers] >= MIN_GAUSSIANS], np.int64)


def _field_of(sketch: Sketch, encoder: EncoderIdentity) -> LanguageField:
    """Return a field with copies of the sketch's vectors as its features."""
    of_row = np.repeat(np.arange(len(sketch.counts)), sketch.counts)
    count, pictures = len(of_row), len(sketch.pictures)
    masks = MaskIds(("",), np.zeros(pictures, np.int32), np.arange(pictures, dtype=np.int32))
    field = LanguageField(
        np.arange(count, dtype=np.uint32),
        _Copies(sketch.features, of_row),
        encoder,
        scene="",
        num_gaussians=count,
        evidence=Evidence(csr_array((count, pictures), dtype=np.float32), masks, sketch.pictures),
        objects=_objects(sketch.numbers[of_row], len(sketch.solid)),
    )
    return field.with_contrast(sketch.words, ("",) * len(sketch.words)) if len(sketch.words) else field


def _objects(number_of_row: Int32[np.ndarray, " r"], count: int) -> Objects:
    """Return objects without places and descriptors: the rows of each."""
    no_places, nothing = np.zeros((count, 3)), np.zeros(count, np.float32)
    return Objects(
        number_of_row, np.full(count, -1, np.int32), np.full(count, THING, np.uint8), nothing,
        no_places, np.broadcast_to(np.eye(3), (count, 3, 3)).copy(), no_places, nothing, np.zeros(count, np.int32),
        np.zeros(count + 1, np.int64), np.empty(0, np.int32), np.empty(0, np.float32),
        np.zeros(count + 1, np.int64), np.empty((0, 1), np.float32),
    )  # fmt: skip
