"""Learning of a scene's code from a few of its views, always the same ones, so that a new view seldom changes it."""

import hashlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..base.arrays import Bool, Flags
from ..base.working import Work
from ..scene.encoders import EncoderIdentity
from .codes import PQ, Codebook, Mixture, Track, train_codebook
from .codes.codebook import MAX_TRAINING_POINTS
from .codes.mixture import SceneAtoms, learn_scene_atoms
from .evidence.aggregation import Aggregated
from .evidence.aggregation.entries import canonical, column_counts, of_columns
from .evidence.evidence import Evidence

MAX_LEARNING_VIEWS = 64


class Learnt(NamedTuple):
    """views: that it was learnt from. codebook: of a product-quantised code. atoms: of a mixture, where it has any."""

    views: tuple[str, ...] = ()
    codebook: Codebook | None = None
    atoms: SceneAtoms | None = None


Sampler = Callable[[Aggregated, Bool[np.ndarray, " m"]], Aggregated]
"""The rows of features that some columns alone have any for. Columns: True for those."""


def rows_of_columns(features: Aggregated, kept: Flags) -> Aggregated:
    """Return the rows of features that some columns alone have any for: a `Sampler` of this process."""
    if not kept.all():
        features = Aggregated(of_columns(features.evidence, kept), features.donors, features.record)
    return features.rows(np.flatnonzero(features.present))


def learn(
    features: Aggregated, code: PQ | Mixture | Codebook, encoder: EncoderIdentity, threads: int, track: Track,
    sampler: Sampler = rows_of_columns, work: Work | None = None,
) -> Learnt:  # fmt: skip
    """Learn what a code needs beside the rows; a given codebook is taken as it is. work: who trains a codebook."""
    if isinstance(code, Codebook):
        return Learnt(codebook=code)
    masks, views = features.evidence.masks, learning_views(features.evidence)
    some = sampler(features, np.isin(masks.view_names, views)[masks.views])
    if isinstance(code, Mixture):
        return Learnt(views, atoms=learn_scene_atoms(source_of(some), threads=threads))
    count = min(len(some), MAX_TRAINING_POINTS)
    spread = np.linspace(0, len(some) - 1, count).astype(np.int64)
    points = some.rows(spread).features(0, count, threads=threads)
    directed = points[points.any(1)]
    parts = code.parts(encoder.dim)
    return Learnt(views, train_codebook(directed, parts, encoder=encoder, threads=threads, track=track, work=work))


def learning_views(evidence: Evidence) -> tuple[str, ...]:
    """Return up to MAX_LEARNING_VIEWS of the views that see anything, by a hash of their names; sorted.

    One view more changes them with a probability of MAX_LEARNING_VIEWS / V, whenever it comes.
    """
    masks = evidence.masks
    seeing = np.unique(masks.views[column_counts(evidence.weights) > 0])
    names = [masks.view_names[view] for view in seeing.tolist()]
    return tuple(sorted(sorted(names, key=drawn)[:MAX_LEARNING_VIEWS]))


def source_of(features: Aggregated) -> Evidence:
    """Return the evidence that each row is a mixture of, in canonical order."""
    rows = features.evidence if features.donors is None else features.evidence.rows(features.donors)
    return canonical(rows)


def drawn(name: str) -> bytes:
    """Return a view's sort key in an order that looks random, and that further views do not change."""
    return hashlib.blake2b(name.encode(), digest_size=8).digest()
