"""The rivals by name: Gaussians and masks in, a feature per Gaussian out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64

from drsplat import Gaussians

from . import LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN, langsplat, legaussians, opengaussian
from .rasterising import Photos


@dataclass(frozen=True, eq=False)
class Made:
    """What a rival answers with: the feature of a Gaussian is its row of a table.

    table: (K, D), zero where the rival gives none. rows: per Gaussian. seen: whether a photo shows it. losses: by
    stage. bytes: of what a Gaussian keeps; shared: of what all keep together.
    """

    table: Float32[np.ndarray, "k d"]
    rows: Int64[np.ndarray, " n"]
    seen: Bool[np.ndarray, " n"]
    losses: Mapping[str, list[float]]
    bytes: int
    shared: int

    @property
    def features(self) -> Float32[np.ndarray, "n d"]:
        """NaN for Gaussians that no photo shows."""
        return np.where(self.seen[:, None], self.table[self.rows], np.float32(np.nan))

    def scores(self, query: Float32[np.ndarray, " d"]) -> Float32[np.ndarray, " n"]:
        """Cosines with a unit vector."""
        return np.where(self.seen, (self.table @ query)[self.rows], np.float32(np.nan))


def make(name: str, gaussians: Gaussians, photos: Photos, effort: float = 1.0) -> Made:
    """effort: share of the steps that the paper takes; at least one of each kind.

    One thread, for the same numbers wherever it runs: products of this size gain nothing from more.
    """
    torch.set_num_threads(1)
    return RIVALS[name](gaussians, photos, effort)


def _langsplat(gaussians: Gaussians, photos: Photos, effort: float) -> Made:
    usual = langsplat.Settings()
    steps, first = _share(usual.steps, effort), _share(usual.autoencoder_steps, effort)
    settings = replace(usual, steps=steps, autoencoder_steps=first, epochs=_share(usual.epochs, effort))
    found = langsplat.fit(photos, settings)
    dim = photos.embeddings.shape[1]
    decoder = sum(a * b + b for a, b in zip((3, *langsplat.DECODER), (*langsplat.DECODER, dim), strict=True))
    losses = {"rendering": found.losses, "autoencoder": found.autoencoder}
    return Made(found.features, np.arange(len(photos.seen)), photos.seen, losses, 12, 4 * decoder)


def _legaussians(gaussians: Gaussians, photos: Photos, effort: float) -> Made:
    usual = legaussians.Settings()
    steps, first = _share(usual.steps, effort), _share(usual.quantise_steps, effort)
    found = legaussians.fit(photos, gaussians.positions, replace(usual, steps=steps, quantise_steps=first))
    reader = (usual.dims + 1) * usual.hidden + (usual.hidden + 1) * usual.atoms
    losses = {"rendering": found.losses, "codebook": found.quantised}
    return Made(found.atoms, found.chosen, photos.seen, losses, 4 * usual.dims, 4 * reader + found.atoms.nbytes)


def _opengaussian(gaussians: Gaussians, photos: Photos, effort: float) -> Made:
    usual = opengaussian.Settings()
    steps = {name: _share(getattr(usual, name), effort) for name in ("steps", "coarse_steps", "fine_steps")}
    found = opengaussian.fit(photos, gaussians.positions, replace(usual, **steps))
    losses = {"contrast": found.losses, "coarse": found.coarse, "fine": found.fine}
    return Made(found.features, found.leaves, photos.seen, losses, 2, found.features.nbytes)


def _share(steps: int, effort: float) -> int:
    return max(1, round(steps * effort))


RIVALS: Mapping[str, Callable[[Gaussians, Photos, float], Made]] = {
    LANGSPLAT: _langsplat,
    LEGAUSSIANS: _legaussians,
    OPENGAUSSIAN: _opengaussian,
}
