"""A small scene whose objects are known: boxes in a row, each of two parts, the first two in a group."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from test_tasks import boxes_scene

from drsplat.field import LanguageField, build_field
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.forest import Objects
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.gaussians import Gaussians

UP = np.array([0.0, 0, 1])
CENTERS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
EACH = 500
SIZES = (1.0, 0.9, 0.8)  # of the three, in opacity
VIEWS = ("a.png", "b.png", "c.png")
TEST = EncoderIdentity("test", 8)


def known_scene() -> Gaussians:
    scene, labels = boxes_scene(CENTERS)
    return replace(scene, opacities=np.array(SIZES, np.float32)[labels])


def known_field(
    gaussians: Gaussians, embeddings: np.ndarray | None = None, encoder: EncoderIdentity = TEST
) -> LanguageField:
    """Per view a mask of each box, and of the first box in view c one of each half; nothing of the last 10 rows.

    embeddings: of the masks, None for unit vectors.
    """
    labels = np.repeat(np.arange(3), EACH)
    rows = np.arange(len(labels) - 10)
    half = (np.arange(len(labels)) // (EACH // 2)) % 2
    entries = [(rows, 3 * view + labels[rows]) for view in range(2)]
    third = np.where(labels == 0, 6 + half, 7 + labels)
    entries.append((rows, third[rows]))
    columns = np.concatenate([column for _, column in entries])
    shape = (len(labels), 10)
    weights = csr_array((np.ones(len(columns), np.float32), (np.concatenate([r for r, _ in entries]), columns)), shape)
    views = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, 2], np.int32)
    masks = MaskIds(VIEWS, views, np.arange(10, dtype=np.int32))
    if embeddings is None:
        embeddings = np.eye(8, dtype=np.float32)[[0, 1, 2, 0, 1, 2, 3, 0, 1, 2]]
    field = build_field(Evidence(weights, masks, embeddings), gaussians.fingerprint, encoder)
    return replace(field, up=UP)


def known_tree(field: LanguageField) -> Tree:
    """Two parts of box 0, one thing each, boxes 0 and 1 in a group."""
    box, half = np.divmod(field.gaussian_ids.astype(np.int64), EACH)
    node_of = np.where(box == 0, half // (EACH // 2), box + 2).astype(np.int32)
    node_of = np.where(box == 0, node_of, box + 2).astype(np.int32)
    parents = np.array([2, 2, 5, 5, -1, -1], np.int32)
    levels = np.array([0, 0, 1, 1, 1, 2], np.uint8)
    return Tree(node_of, parents, levels, np.array([1, 0.9, 0.8, 0.7, 0.6, 0.5], np.float32))


def with_objects(threads: int = 0) -> tuple[LanguageField, Gaussians]:
    gaussians = known_scene()
    field = known_field(gaussians)
    return field.with_objects(described(field, gaussians, threads)), gaussians


def described(field: LanguageField, gaussians: Gaussians, threads: int = 0) -> Objects:
    return describe(field, gaussians, known_tree(field), threads=threads)
