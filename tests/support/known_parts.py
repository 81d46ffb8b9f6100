"""A scene's own Gaussians divided into parts, so that the truth is known to the last one, as it never is with photos.

Masks are the parts as they are seen: per pixel the part of the largest blending weight. Embeddings are a random
vector per part plus noise of half its length in every mask, as masks of one thing differ between photos.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

import drsplat as ds
from drsplat.kernels import render_channels, splat_arrays

DIM = 512
NOISE = 0.5  # length of the noise on a unit vector: masks of one part are at cosine 0.8
THRESHOLD = 0.5


class Parts(NamedTuple):
    """labels: part of each Gaussian. margin: distance to the border with the next part, scene units."""

    labels: Int32[np.ndarray, " n"]
    margin: Float64[np.ndarray, " n"]


class Findings(NamedTuple):
    """ious: per part, over registered Gaussians. wrong: selected for another part, or for none."""

    registration: ds.Registration
    field: ds.LanguageField
    ious: Float64[np.ndarray, " p"]
    wrong: Bool[np.ndarray, " r"]


def divide(gaussians: ds.Gaussians, num_parts: int, seed: int = 0) -> Parts:
    """Spatial clusters of the solid Gaussians; faint ones belong to the nearest."""
    points = gaussians.means.astype(np.float64)
    solid = points[gaussians.opacities > 0.3]
    middles, _ = kmeans2(solid, num_parts, minit="++", seed=seed)
    distances, nearest = cKDTree(middles).query(points, k=2)
    apart = np.linalg.norm(middles[nearest[:, 0]] - middles[nearest[:, 1]], axis=1)
    return Parts(nearest[:, 0].astype(np.int32), (distances[:, 1] ** 2 - distances[:, 0] ** 2) / (2 * apart))


def part_masks(
    gaussians: ds.Gaussians, views: Sequence[ds.View], parts: Parts, directions: Float32[np.ndarray, "p d"]
) -> dict[str, ds.ViewFeatures]:
    """Features of every view: the part seen at each pixel, noisy vectors."""
    splats, rng, features = splat_arrays(gaussians), np.random.default_rng(1), {}
    one_hot = np.eye(len(directions), dtype=np.float32)[parts.labels]
    for view in views:
        seen = render_channels(splats, view, one_hot)
        mask_ids = np.where(seen.alpha < 0.5, -1, seen.channels.argmax(-1)).astype(np.int32)
        noise = rng.standard_normal(directions.shape)
        noisy = directions + NOISE * noise / np.linalg.norm(noise, axis=1, keepdims=True)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        features[view.name] = ds.ViewFeatures(mask_ids, noisy.astype(np.float32))
    return features


def search_parts(gaussians: ds.Gaussians, views: Sequence[ds.View], parts: Parts) -> Findings:
    """Register the masks of the parts and search every part by its vector."""
    directions = np.random.default_rng(2).standard_normal((parts.labels.max() + 1, DIM)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    features = part_masks(gaussians, views, parts, directions)
    registration = ds.register(gaussians, views, features)
    field = registration.to_field()
    truth = parts.labels[field.gaussian_ids]
    found = np.stack([field.scores(direction) > THRESHOLD for direction in directions])
    true = truth == np.arange(len(directions))[:, None]
    ious = (found & true).sum(1) / (found | true).sum(1)
    return Findings(registration, field, ious, (found != true).any(0))
