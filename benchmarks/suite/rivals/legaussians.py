"""LEGaussians-m: a few numbers per Gaussian that a small network turns into one of the atoms of a codebook.

The embeddings of the photos are quantised, each to an atom; features and an uncertainty per Gaussian are fitted so that
the network reads the atom of each pixel in their rendering, and features are held near those of a network of the place.
"-m": the atom of each Gaussian is read from its own features and looked up in 3D.

Source: Shi et al., LEGaussians (CVPR 2024) Sec. 3: 128 atoms, 8 numbers, load balancing of the codebook, uncertainty
that weighs the cross entropy, smoothing by a network of encoded positions. Departures: embeddings are those of the
masks, which all methods here are given, and not CLIP's of patches beside DINO's; geometry and colours are frozen, as
those of all others here; a step reads the atoms of some pixels, drawn anew; rates, weights of the last two terms and
the network's width are ours, where we found none.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64
from torch import nn

from .rasterising import TRACE, Photo, Photos, blended, fitted
from .stepping import adam, means_of, stepping


@dataclass(frozen=True)
class Settings:
    atoms: int = 128
    dims: int = 8
    hidden: int = 128
    frequencies: int = 6
    quantise_steps: int = 3_000
    quantise_rate: float = 1e-2
    balance: float = 0.5
    temperature: float = 0.1
    pixels: int = 8192  # of a photo that a step looks at
    steps: int = 30_000
    rate: float = 2.5e-3
    network_rate: float = 1e-3
    certain: float = 0.1  # weight of the mean uncertainty
    smooth: float = 0.1
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Fitted:
    """atoms: unit. chosen: per Gaussian one. losses: of rendering. quantised: of the codebook.

    cosine: of embeddings and their atoms.
    """

    atoms: Float32[np.ndarray, "k d"]
    chosen: Int64[np.ndarray, " n"]
    losses: list[float]
    quantised: list[float]
    cosine: float


def fit(photos: Photos, positions: Float64[np.ndarray, "n 3"], settings: Settings = Settings()) -> Fitted:
    torch.manual_seed(settings.seed)
    embeddings, device = photos.embeddings, photos.device
    atoms, quantised = codebook(embeddings, settings)
    labels = (embeddings @ atoms.T).argmax(1)
    values = nn.Parameter((0.01 * torch.randn(photos.num_gaussians, settings.dims)).to(device))
    doubts = nn.Parameter(torch.full((photos.num_gaussians, 1), -3.0, device=device))
    reader = _network(settings.dims, settings.hidden, settings.atoms).to(device)
    places = _encoded(positions, settings.frequencies).to(device)
    smoother = _network(places.shape[1], settings.hidden, settings.dims).to(device)

    def loss(photo: Photo) -> torch.Tensor:
        rendered = blended(photo, torch.cat([values, torch.sigmoid(doubts)], 1))
        drawn = torch.randint(len(rendered), (min(settings.pixels, len(rendered)),), device=device)
        looked_at = rendered.index_select(0, drawn)
        doubt = looked_at[:, -1].clamp(0, 1)
        read, meant = reader(looked_at[:, :-1]), labels[photo.numbers[photo.masks[drawn]]]
        wrong = nn.functional.cross_entropy(read, meant, reduction="none")
        some = torch.randint(len(values), (4096,), device=device)
        by_place, own = smoother(places[some]), values.index_select(0, some)
        uncertain = torch.sigmoid(doubts[some]).detach()
        held = ((by_place - own.detach()).square() + uncertain * (by_place.detach() - own).square()).mean()
        return (wrong * (1 - doubt)).mean() + settings.certain * doubt.mean() + settings.smooth * held

    networks = [*reader.parameters(), *smoother.parameters()]
    groups = [{"params": [values, doubts], "lr": settings.rate}, {"params": networks, "lr": settings.network_rate}]
    losses = fitted(photos.photos, loss, groups, settings.steps, settings.seed)
    with torch.no_grad():
        chosen = torch.cat([reader(part).argmax(1) for part in values.split(65536)])
        cosine = float((embeddings * atoms[labels]).sum(1).mean())
    return Fitted(atoms.cpu().numpy(), chosen.cpu().numpy(), losses, quantised, cosine)


def codebook(embeddings: torch.Tensor, settings: Settings) -> tuple[torch.Tensor, list[float]]:
    """Unit atoms that embeddings are near to, all of them used: the paper's cosine loss and load balancing."""
    device, near = embeddings.device, 0.01 * torch.randn(settings.atoms, embeddings.shape[1])
    start = torch.randint(len(embeddings), (settings.atoms,), device=device)
    atoms = nn.Parameter(embeddings[start] + near.to(device))

    def loss() -> torch.Tensor:
        some = embeddings[torch.randint(len(embeddings), (min(1024, len(embeddings)),), device=device)]
        cosines = some @ nn.functional.normalize(atoms).T
        used = torch.zeros(settings.atoms, device=device)
        used = used.index_add(0, cosines.argmax(1), torch.ones(len(some), device=device)) / len(some)
        likely = (cosines / settings.temperature).softmax(1).mean(0)
        return 1 - cosines.amax(1).mean() + settings.balance * (used * likely).sum()

    step = stepping(adam([{"params": [atoms], "lr": settings.quantise_rate}], device), loss, device)
    losses = torch.zeros(settings.quantise_steps, device=device)
    for number in range(settings.quantise_steps):
        losses[number] = step()
    return nn.functional.normalize(atoms.detach()), means_of(losses, TRACE)


def _network(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))


def _encoded(positions: Float64[np.ndarray, "n 3"], frequencies: int) -> torch.Tensor:
    """Sines and cosines of positions in a unit cube."""
    low, high = np.quantile(positions, (0.01, 0.99), axis=0)
    unit = torch.from_numpy(np.clip((positions - low) / np.maximum(high - low, 1e-9), -1, 2).astype(np.float32))
    waves = [unit * (2**k * torch.pi) for k in range(frequencies)]
    return torch.cat([unit, *(wave.sin() for wave in waves), *(wave.cos() for wave in waves)], 1)
