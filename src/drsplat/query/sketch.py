"""A scene in few vectors: enough for its own rules to tell, nearly as its field does, which objects it answers with."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base.arrays import Float32, Int32, Int64, Integer
from ..errors import FormatError
from ..field import LanguageField
from ..field.codes.mixture.scene_atoms import spherical_kmeans
from ..kernels.mixture import nearest_centres
from ..scene.boxes import HAZE_OPACITY
from .contrast import usual_pictures
from .objects import objects_of
from .packed import Packed
from .scene import Scene
from .thresholds import PEAK_ROWS

MAX_VECTORS_OF_OBJECT, MAX_LOOSE_VECTORS = 4, 32  # loose: for all Gaussians that belong to no object
MIN_ROWS_PER_VECTOR = 16  # that it is the mean of
SAMPLED_ROWS = 1024  # of an object, spread over all of it, that say which are alike
MAX_PICTURES = 128
MAX_ROWS = 20_000  # that all vectors together stand for; large scenes are thinned
SEED = 0
VECTORS, NUMBERS = ("features", "pictures", "words"), ("counts", "numbers", "solid")


@dataclass(frozen=True, eq=False)
class Sketch:
    """Part of a scene's field that is kept to query it by its own rules.

    features: means of rows that are alike, each in place of `counts` rows of the object `numbers`, -1 for none.
    pictures: some of the photos' masks, which say what is usual. words: the list that the field keeps, none where it
    keeps none. solid: per object its Gaussians that can be seen; of fewer than 40 there is no match. labels: the names
    that people gave to objects, by their numbers.
    """

    features: Packed
    counts: Int32[np.ndarray, " p"]
    numbers: Int32[np.ndarray, " p"]
    pictures: Packed
    words: Packed
    solid: Int32[np.ndarray, " o"]
    labels: Mapping[int, str]

    @cached_property
    def firsts(self) -> Int64[np.ndarray, " p"]:
        """Per vector the first of the rows that it stands for, if all rows are in its order."""
        return np.asarray(np.cumsum(self.counts) - self.counts, np.int64)

    def to_bytes(self) -> bytes:
        """Return it as a file of safetensors, six bits for each number of a vector."""
        from safetensors.numpy import save

        arrays = {name: _narrow(getattr(self, name)) for name in NUMBERS}
        for name in VECTORS:
            packed = getattr(self, name)
            arrays |= {name: packed.data, f"{name}_steps": packed.steps} if len(packed) else {}
        arrays["labels"] = np.frombuffer(json.dumps(dict(self.labels)).encode(), np.uint8)
        return bytes(save(arrays))

    @classmethod
    def from_bytes(cls, data: bytes, dim: int) -> "Sketch":
        """Read what `to_bytes` wrote. Raises: FormatError: something else, or numbers that do not fit each other."""
        from safetensors import SafetensorError
        from safetensors.numpy import load

        try:
            arrays = load(data)
            counts, numbers, solid = (arrays[name].astype(np.int32, casting="safe") for name in NUMBERS)
            features, pictures, words = (_read(arrays, name, dim) for name in VECTORS)
            for vectors in filter(len, (pictures, words)):
                unit(vectors)
            labels = _labels(arrays["labels"].tobytes())
        except (SafetensorError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise FormatError(f"no sketch of a scene ({error!s:.200})") from error
        _check(len(features), len(pictures), counts, numbers, solid, labels)
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


def _narrow(numbers: Int32[np.ndarray, " p"]) -> Integer[np.ndarray, " p"]:
    is_short = numbers.max(initial=0) <= np.iinfo(np.int16).max
    return numbers.astype(np.int16) if is_short else numbers


def _read(arrays: Mapping[str, np.ndarray], name: str, dim: int) -> Packed:
    """Return vectors; none where the file has none. Raises: KeyError, ValueError: something else."""
    if name not in arrays:
        return Packed.none(dim)
    return Packed.checked(arrays[name], arrays[f"{name}_steps"], dim)


def _labels(document: bytes) -> dict[int, str]:
    """Read labels by the numbers of objects. Raises: ValueError, AttributeError: something else."""
    labels = {int(key): label for key, label in json.loads(document).items()}
    if not all(type(label) is str for label in labels.values()):
        raise ValueError("expected labels that are texts")
    return labels


def unit(packed: Packed) -> Float32[np.ndarray, "p D"]:
    """Return unit vectors that were rounded, of unit length. Raises: ValueError: they are far from unit."""
    vectors = packed.vectors
    lengths = np.sqrt(np.einsum("pd,pd->p", vectors, vectors))
    if (np.abs(lengths - 1) > 0.5).any():
        raise ValueError("vectors that are not of unit length")
    return np.asarray(vectors / lengths[:, None], np.float32)


def _check(
    features: int, pictures: int, counts: np.ndarray, numbers: np.ndarray, solid: np.ndarray, labels: Mapping[int, str]
) -> None:
    """Check a sketch. Raises: FormatError: numbers that do not fit each other, or more rows than sketches have."""
    fits = counts.shape == numbers.shape == (features,) and solid.ndim == 1
    most = MAX_ROWS + PEAK_ROWS * counts.size
    if not fits or not pictures or (counts < 1).any() or counts.sum(dtype=np.int64) > most:
        raise FormatError("a sketch of a scene whose parts do not fit each other")
    is_known = numbers.min(initial=-1) >= -1 and numbers.max(initial=-1) < len(solid)
    if not is_known or not all(0 <= number < len(solid) for number in labels):
        raise FormatError(f"a sketch of a scene with an object that is not among its {len(solid)}")
