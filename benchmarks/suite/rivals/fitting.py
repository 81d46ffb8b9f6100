"""The rivals by name: Gaussians and masks in, a feature per Gaussian out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float32

from drsplat import Gaussians

from . import LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN, langsplat, legaussians, opengaussian
from .rasterising import Photos


@dataclass(frozen=True, eq=False)
class Made:
    """features: (N, D), NaN for Gaussians that no photo shows, zero where the rival gives none. losses: by stage.

    bytes: of what a Gaussian keeps; shared: of what all keep together.
    """

    features: Float32[np.ndarray, "n d"]
    losses: Mapping[str, list[float]]
    bytes: float
    shared: int


def make(name: str, gaussians: Gaussians, photos: Photos, effort: float = 1.0) -> Made:
    """effort: share of the steps that the paper takes; at least one of each kind.

    One thread, for the same numbers wherever it runs: products of this size gain nothing from more.
    """
    torch.set_num_threads(1)
    made = RIVALS[name](gaussians, photos, effort)
    features = np.where(photos.seen[:, None], made.features, np.nan).astype(np.float32)
    return replace(made, features=features)


def _langsplat(gaussians: Gaussians, photos: Photos, effort: float) -> Made:
    usual = langsplat.Settings()
    steps, first = _share(usual.steps, effort), _share(usual.autoencoder_steps, effort)
    settings = replace(usual, steps=steps, autoencoder_steps=first, epochs=_share(usual.epochs, effort))
    found = langsplat.fit(photos, settings)
    dim = photos.embeddings.shape[1]
    decoder = sum(a * b + b for a, b in zip((3, *langsplat.DECODER), (*langsplat.DECODER, dim), strict=True))
    return Made(found.features, {"rendering": found.losses, "autoencoder": found.autoencoder}, 12, 4 * decoder)


def _legaussians(gaussians: Gaussians, photos: Photos, effort: float) -> Made:
    usual = legaussians.Settings()
    steps, first = _share(usual.steps, effort), _share(usual.quantise_steps, effort)
    found = legaussians.fit(photos, gaussians.positions, replace(usual, steps=steps, quantise_steps=first))
    reader = (usual.dims + 1) * usual.hidden + (usual.hidden + 1) * usual.atoms
    shared = 4 * (reader + usual.atoms * photos.embeddings.shape[1])
    return Made(found.features, {"rendering": found.losses, "codebook": found.quantised}, 4 * usual.dims, shared)


def _opengaussian(gaussians: Gaussians, photos: Photos, effort: float) -> Made:
    usual = opengaussian.Settings()
    steps = {name: _share(getattr(usual, name), effort) for name in ("steps", "coarse_steps", "fine_steps")}
    found = opengaussian.fit(photos, gaussians.positions, replace(usual, **steps))
    leaves = usual.coarse * usual.fine
    losses = {"contrast": found.losses, "coarse": found.coarse, "fine": found.fine}
    return Made(found.features, losses, 2, 4 * leaves * photos.embeddings.shape[1])


def _share(steps: int, effort: float) -> int:
    return max(1, round(steps * effort))


RIVALS: Mapping[str, Callable[[Gaussians, Photos, float], Made]] = {
    LANGSPLAT: _langsplat,
    LEGAUSSIANS: _legaussians,
    OPENGAUSSIAN: _opengaussian,
}
