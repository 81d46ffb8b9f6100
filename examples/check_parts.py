"""How exact is registration on a real scene? Search for parts whose every Gaussian is known.

    python examples/check_parts.py scene.ply

The scene's own Gaussians are divided into parts by position, so the truth is known to the last
Gaussian, which it never is with photos. Masks are the parts as they are seen: per pixel the part of
the largest blending weight. Embeddings are a random vector per part plus noise of half its length in
every mask, as masks of one thing differ between photos. Then each part is searched by its vector.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32
from register_a_splat import UPS, orbit
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

import drsplat as ds
from drsplat.kernels import render_channels

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
    seconds: float


def divide(gaussians: ds.Gaussians, num_parts: int, seed: int = 0) -> Parts:
    """Spatial clusters of the solid Gaussians; faint ones belong to the nearest."""
    points = gaussians.means.astype(np.float64)
    solid = points[gaussians.opacities > 0.3]
    middles, _ = kmeans2(solid, num_parts, minit="++", seed=seed)
    distances, nearest = cKDTree(middles).query(points, k=2)
    apart = np.linalg.norm(middles[nearest[:, 0]] - middles[nearest[:, 1]], axis=1)
    return Parts(
        nearest[:, 0].astype(np.int32), (distances[:, 1] ** 2 - distances[:, 0] ** 2) / (2 * apart)
    )


def part_masks(
    gaussians: ds.Gaussians,
    views: Sequence[ds.View],
    parts: Parts,
    directions: Float32[np.ndarray, "p d"],
) -> dict[str, ds.ViewFeatures]:
    """Features of every view: the part seen at each pixel, noisy vectors."""
    splats, rng, features = ds.splat_arrays(gaussians), np.random.default_rng(1), {}
    one_hot = np.eye(len(directions), dtype=np.float32)[parts.labels]
    for view in views:
        seen = render_channels(splats, view, one_hot)
        segment_ids = np.where(seen.alpha < 0.5, -1, seen.channels.argmax(-1)).astype(np.int32)
        noise = rng.standard_normal(directions.shape)
        noisy = directions + NOISE * noise / np.linalg.norm(noise, axis=1, keepdims=True)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        features[view.name] = ds.ViewFeatures(segment_ids, noisy.astype(np.float32))
    return features


def search_parts(
    gaussians: ds.Gaussians, views: Sequence[ds.View], parts: Parts, *, topk: int | None = 40
) -> Findings:
    """Register the masks of the parts and search every part by its vector."""
    directions = (
        np.random.default_rng(2).standard_normal((parts.labels.max() + 1, DIM)).astype(np.float32)
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    features = part_masks(gaussians, views, parts, directions)
    began = time.perf_counter()
    registration = ds.register(gaussians, views, features, topk)
    field = registration.to_field()
    seconds = time.perf_counter() - began
    truth = parts.labels[field.gaussian_ids]
    found = np.stack([field.scores(direction) > THRESHOLD for direction in directions])
    true = truth == np.arange(len(directions))[:, None]
    ious = (found & true).sum(1) / (found | true).sum(1)
    return Findings(registration, field, ious, (found != true).any(0), seconds)


def explain_misses(gaussians: ds.Gaussians, parts: Parts, findings: Findings) -> None:
    """Where what is wrong lies: along the borders of parts, or where hardly any ray comes."""
    ids = findings.field.gaussian_ids
    reach = 2 * gaussians.scales[ids].max(1)
    at_border = parts.margin[ids] < reach
    weights = np.asarray(findings.registration.weights.sum(axis=1)).ravel()[ids]
    hidden = ~at_border & (weights < np.quantile(weights, 0.25))
    absent = np.setdiff1d(np.arange(len(gaussians)), ids)
    print(f"wrong: {findings.wrong.mean():.2%} of the registered Gaussians")
    groups = {
        "within two sigma of a border": at_border,
        "else, of the quarter least seen": hidden,
        "else": ~at_border & ~hidden,
    }
    for label, group in groups.items():
        share = findings.wrong[group].mean() if group.any() else 0.0
        print(f"  {label}: {group.mean():6.1%} of them, {share:.2%} of these wrong")
    print(
        f"not registered: {len(absent):,} Gaussians, median opacity "
        f"{np.median(gaussians.opacities[absent]) if len(absent) else 0:.3f}, "
        f"{np.median(gaussians.opacities):.3f} in the scene"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", type=Path, help="3DGS PLY, compressed PLY, SPZ or .splat")
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--size", type=int, default=800, help="longer side of a view, in pixels")
    parser.add_argument("--parts", type=int, default=12)
    parser.add_argument("--up", choices=UPS, default="-y")
    options = parser.parse_args()
    gaussians = ds.read_gaussians(options.scene)
    views = orbit(gaussians, np.array(UPS[options.up], np.float64), options.views, options.size)
    parts = divide(gaussians, options.parts)
    findings = search_parts(gaussians, views, parts)
    registered = findings.registration.num_registered
    print(
        f"{len(gaussians):,} Gaussians, {registered:,} registered ({registered / len(gaussians):.1%}) "
        f"from {options.views} views in {findings.seconds:.1f} s\n"
        f"IoU of {len(findings.ious)} parts: mean {findings.ious.mean():.3f}, "
        f"least {findings.ious.min():.3f}, largest {findings.ious.max():.3f}"
    )
    explain_misses(gaussians, parts, findings)


if __name__ == "__main__":
    main()
