"""LangSplat-m: three numbers per Gaussian that an autoencoder of the scene makes of 512, fitted by rendering.

"-m": features are decoded per Gaussian and looked up in 3D, as Dr. Splat's tables do it, and not in a rendered picture.

Source: Qin et al., LangSplat (CVPR 2024) Sec. 3; sizes and rates are those of its released settings. Departures: one
level of masks, which is what all methods here are given; photos are `rasterising.WIDTH` pixels wide; an autoencoder of
few masks is trained for `autoencoder_steps` where 100 epochs are less, since the paper's epochs are of 100,000 crops.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float32
from torch import nn

from .rasterising import TRACE, Photo, Photos, blended, fitted
from .stepping import adam, means_of, stepping

ENCODER, DECODER = (256, 128, 64, 32, 3), (16, 32, 64, 128, 256, 256)
COSINE = 0.001  # of the autoencoder's loss


@dataclass(frozen=True)
class Settings:
    epochs: int = 100
    autoencoder_steps: int = 20_000
    batch: int = 64
    autoencoder_rate: float = 1e-4
    steps: int = 30_000
    rate: float = 2.5e-3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Fitted:
    """features: (N, D) unit, of Gaussians that a photo shows. losses: of rendering, and of the autoencoder before."""

    features: Float32[np.ndarray, "n d"]
    losses: list[float]
    autoencoder: list[float]


class Autoencoder(nn.Module):
    def __init__(self, dim: int) -> None:
        super().__init__()
        inner = [nn.Linear(dim, ENCODER[0])]
        for a, b in pairwise(ENCODER):
            inner += [nn.BatchNorm1d(a), nn.ReLU(), nn.Linear(a, b)]
        outer = [nn.Linear(ENCODER[-1], DECODER[0])]
        for a, b in zip(DECODER, (*DECODER[1:], dim), strict=True):
            outer += [nn.ReLU(), nn.Linear(a, b)]
        self.encoder, self.decoder = nn.Sequential(*inner), nn.Sequential(*outer)

    def encode(self, embeddings: torch.Tensor) -> torch.Tensor:
        return nn.functional.normalize(self.encoder(embeddings))

    def decode(self, codes: torch.Tensor) -> torch.Tensor:
        return nn.functional.normalize(self.decoder(codes))


def fit(photos: Photos, settings: Settings = Settings()) -> Fitted:
    torch.manual_seed(settings.seed)
    model = Autoencoder(photos.embeddings.shape[1]).to(photos.device)
    first = _train(model, photos.embeddings, settings)
    with torch.no_grad():
        targets = model.encode(photos.embeddings)
    values = nn.Parameter(torch.full((photos.num_gaussians, ENCODER[-1]), 1e-3, device=photos.device))

    def loss(photo: Photo) -> torch.Tensor:
        rendered = blended(photo, nn.functional.normalize(values))
        return (rendered - targets[photo.numbers][photo.masks]).abs().mean()

    losses = fitted(photos.photos, loss, [{"params": [values], "lr": settings.rate}], settings.steps, settings.seed)
    with torch.no_grad():
        features = model.decode(nn.functional.normalize(values)).cpu().numpy()
    return Fitted(features, losses, first)


def _train(model: Autoencoder, embeddings: torch.Tensor, settings: Settings) -> list[float]:
    """The mean losses of up to `TRACE` stretches of steps."""
    device = embeddings.device
    batch = min(settings.batch, len(embeddings))
    each = max(len(embeddings) // batch, 1)
    epochs = max(settings.epochs, -(-settings.autoencoder_steps // each))
    chosen = torch.zeros(batch, dtype=torch.int64, device=device)

    def loss() -> torch.Tensor:
        some = embeddings[chosen]
        again = model.decode(model.encode(some))
        cosine = 1 - nn.functional.cosine_similarity(again, some).mean()
        return (again - some).square().mean() + COSINE * cosine

    group = {"params": list(model.parameters()), "lr": settings.autoencoder_rate}
    step, losses = stepping(adam([group], device), loss, device), torch.zeros(epochs * each, device=device)
    for epoch in range(epochs):
        order = torch.randperm(len(embeddings)).to(device)
        for at in range(each):
            chosen.copy_(order[at * batch : (at + 1) * batch])
            losses[epoch * each + at] = step()
    model.eval()
    return means_of(losses, TRACE)
