"""A page's features, decoded: the field that its client searches, to be asked by the engine itself."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drsplat.field.codes.code import Best, Hits
from drsplat.photos.models.mini import MiniEncoder
from drsplat.query import Scene


@dataclass(frozen=True, eq=False)
class Dense:
    """Features as they are."""

    features: np.ndarray
    kind = "dense"
    nbytes = 0

    @property
    def dim(self) -> int:
        return int(self.features.shape[1])

    def __len__(self) -> int:
        return len(self.features)

    def scores(self, queries: np.ndarray, *, threads: int = 0) -> np.ndarray:
        return np.asarray(queries @ self.features.T, np.float32)

    def decode(self, rows: np.ndarray) -> np.ndarray:
        return np.asarray(self.features[rows])

    def rows(self, index: np.ndarray) -> "Dense":
        return Dense(self.features[index])

    def run(self, begin: int, end: int) -> "Dense":
        return Dense(self.features[begin:end])

    def tensors(self) -> dict[str, np.ndarray]:
        return {"features": self.features}

    def select(self, *_: Any, **__: Any) -> Hits:
        raise NotImplementedError

    def top(self, *_: Any, **__: Any) -> Hits:
        raise NotImplementedError

    def best(self, queries: np.ndarray, *, threads: int = 0) -> Best:
        scores = self.scores(queries)
        second = np.sort(np.concatenate([np.full_like(scores[:1], -np.inf), scores]), axis=0)[-2]
        return Best(scores.argmax(axis=0).astype(np.int32), scores.max(axis=0), second)


def decoded(scene: Scene, arrays: dict[str, np.ndarray], order: np.ndarray) -> Scene:
    """Return a scene whose features are those of a page, in the page's own basis. order: its Gaussians in the scene.

    The built-in encoder's words are those of the page as well.
    """
    stages, rows, dim = len(arrays["steps"]), scene.field.rows_of(order), len(arrays["usual"])
    centroids = arrays["centroids"].reshape(stages, 256, -1).astype(np.float32) - 128
    features = np.zeros((len(scene.field), dim), np.float32)
    for stage, step in enumerate(arrays["steps"]):
        chosen = centroids[stage][arrays[f"code{stage}"][rows >= 0]]
        features[rows[rows >= 0], : centroids.shape[2]] += step * chosen
    texts = arrays["texts"].reshape(-1, dim).astype(np.float32)
    encoder = MiniEncoder()
    encoder.weights, encoder.photo_colors = {"words": texts[:-11]}, texts[-11:]
    encoder.identity = replace(encoder.identity, dim=dim)
    code: Any = Dense(features)
    field = replace(scene.field, code=code, evidence=None, growth=None, objects=None, encoder=encoder.identity)
    objects = scene.field.objects
    if objects is not None:
        field = field.with_objects(
            replace(
                objects, descriptors=np.eye(dim, dtype=np.float32)[:0], descriptor_starts=0 * objects.descriptor_starts
            )
        )
    return Scene(field, scene.gaussians, scene.views, encoder)
