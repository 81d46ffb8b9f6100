"""The contents of a part of a scene, by name."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arrays import Array, Indices, Vector3
from ..errors import InputError
from ..kernels.algebra import dense_rows
from .defaults import MIN_GAUSSIANS
from .naming import own_vocabulary
from .scene import Scene


class InRegion(NamedTuple):
    """A name that a share of a region's Gaussians has. center: their median in the world. score: mean cosine."""

    name: str
    num_gaussians: int
    share: float
    score: float
    center: Vector3


def region(
    scene: Scene, center: tuple[float, float, float], radius: float, vocabulary: Sequence[str] | None = None
) -> list[InRegion]:
    """Name the Gaussians within `radius` (scene units) of a point, most frequent name first.

    Each has the name of the highest cosine. A name has to have 40 Gaussians there, and to exceed the
    threshold of an encoder that has one. vocabulary: as for `what_is`.

    Raises: InputError: a radius that is not positive, nothing with a feature there, no list of words.
    """
    at = np.asarray(center, np.float64)
    if not (np.isfinite(at).all() and np.isfinite(radius) and radius > 0):
        raise InputError(f"expected a point and a positive radius, got {center}, {radius}")
    field, encoder = scene.field, scene.encoder
    names = own_vocabulary(encoder, field) if vocabulary is None else tuple(dict.fromkeys(vocabulary))
    if not names:
        raise InputError(f"'{encoder.identity.name}' takes any words: name those to choose from")
    inside = _within(scene, at, radius)
    if not len(inside):
        raise InputError(f"no Gaussian with a feature is within {radius:g} of {at[0]:g}, {at[1]:g}, {at[2]:g}")
    field.check_encoder(encoder.identity)
    means = scene.rows.shapes_of(field.gaussian_ids[inside]).positions
    features = field.feature(inside)
    vectors = np.asarray(encoder.encode_texts(names), np.float32)
    scores = dense_rows(features, vectors.T, threads=scene.threads)
    best, own = scores.argmax(1), scores.max(1)
    clear = own > getattr(encoder, "threshold", -1.0)
    found = [_named(names[k], (best == k) & clear, own, means) for k in np.unique(best[clear])]
    kept = [one for one in found if one.num_gaussians >= MIN_GAUSSIANS]
    return sorted(kept, key=lambda one: -one.num_gaussians)


def _within(scene: Scene, at: Vector3, radius: float) -> Indices:
    """Return the rows of the field whose Gaussians have their centres within a radius of a point, ascending."""
    rows, ids = [np.empty(0, np.int64)], scene.field.gaussian_ids
    for first, away2, part in scene.rows.parts_near(at):
        if away2 > radius * radius:
            break
        begin, end = np.searchsorted(ids, np.array([first, first + len(part)], ids.dtype))
        means = part.means[ids[begin:end] - first].astype(np.float64) + part.origin
        with np.errstate(over="ignore"):  # further away than can be squared is outside
            (near,) = np.nonzero(np.linalg.norm(means - at, axis=1) <= radius)
        rows.append(near + begin)
    return np.sort(np.concatenate(rows))


def _named(name: str, mine: Array, scores: Array, means: Array) -> InRegion:
    count = int(mine.sum())
    center = np.median(means[mine], axis=0)
    return InRegion(name, count, count / len(mine), float(scores[mine].mean()), center)
