"""A scene of three boxes that answer words, for tests of the viewer."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from drsplat.field import build_field
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.photos.models.words import WordEncoder
from drsplat.query import Scene
from drsplat.scene.gaussians import Gaussians
from scenes import gaussians_at, look_at_view

THINGS = ("red mug", "blue mug", "tall lamp")
CENTERS = ((-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.2, 0.0, 0.3))
EACH, HAZE = 300, 60


def boxes() -> tuple[Gaussians, np.ndarray]:
    """Three boxes of Gaussians and a few loose ones that have no feature (label -1)."""
    rng = np.random.default_rng(3)
    local = (rng.random((3, EACH, 3)) - 0.5) * (0.4, 0.3, 0.2)
    points = (local + np.array(CENTERS)[:, None]).reshape(-1, 3)
    points = np.concatenate([points, rng.uniform(-3, 3, (HAZE, 3))])
    colors = rng.uniform(-1, 1, (len(points), 1, 3)).astype(np.float32)
    scene = replace(gaussians_at(points, 0.03, opacity=0.8), sh=colors)
    labels = np.concatenate([np.repeat(np.arange(3), EACH), np.full(HAZE, -1)])
    return scene, labels


def boxes_scene() -> Scene:
    scene, labels = boxes()
    words = WordEncoder()
    found = labels >= 0
    indptr = np.concatenate([[0], np.cumsum(found)])
    weights = csr_array(
        (np.ones(found.sum(), np.float32), labels[found].astype(np.int32), indptr), shape=(len(scene), 3)
    )
    masks = MaskIds(("view.png",), np.zeros(3, np.int32), np.arange(3, dtype=np.int32))
    evidence = Evidence(weights, masks, words.encode_texts(THINGS))
    field = build_field(evidence, scene.fingerprint, words.identity)
    views = (look_at_view((0.0, -3.0, 1.0)), look_at_view((0.5, -3.0, 1.2)))
    return Scene(field, scene, views, WordEncoder, name="boxes", threads=1)
