"""OpenGaussian: instance features from nameless masks, two levels of clusters, and the masks' embeddings on these.

1. Six numbers per Gaussian, rendered: alike within a mask, unlike between the masks of a photo.
2. A coarse codebook of them and of positions, and within each of its clusters a fine one of them alone; after each the
   features are fitted to render as their clusters do.
3. In every photo a cluster takes the embedding of the mask with the largest IoU, with what the photo shows of the
   cluster, times one minus the distance of their features; the mean over photos is what its Gaussians are looked up by.

Source: Wu et al., OpenGaussian (NeurIPS 2024) Sec. 3: losses, 6 numbers, 64 coarse and 5 fine clusters, 10,000 steps
for features and for the coarse level, 20,000 for the fine one. Departures: the weight of positions beside features,
and that features begin nearly alike, are ours; clusters come from k-means of 20 rounds, `REFRESHED` times in a stage
of fitting; what a photo shows of a cluster is what it shows most of at a pixel, in place of a rendering of the cluster
alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64
from torch import nn

from .rasterising import Photo, Photos, blended, fitted

DIMS = 6
SPREAD = 0.1  # of the features at first: what photos blend away of a wider one stays in the Gaussians as noise
LEAST_PIXELS = 4  # of a cluster, for a photo to count
ROUNDS = 20
REFRESHED = 10  # times that clusters are found anew in a stage


@dataclass(frozen=True)
class Settings:
    steps: int = 10_000
    coarse_steps: int = 10_000
    fine_steps: int = 20_000
    rate: float = 1e-3
    coarse: int = 64
    fine: int = 5
    positions: float = 0.5  # weight beside features of length 1, positions in a unit cube
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Fitted:
    """features: of leaves, unit, zero where no mask was found. leaves: per Gaussian its own. losses: of step 1."""

    features: Float32[np.ndarray, "k d"]
    leaves: Int64[np.ndarray, " n"]
    losses: list[float]
    coarse: list[float]
    fine: list[float]


def fit(photos: Photos, positions: Float64[np.ndarray, "n 3"], settings: Settings = Settings()) -> Fitted:
    torch.manual_seed(settings.seed)
    start = nn.functional.normalize(1 + SPREAD * torch.randn(photos.num_gaussians, DIMS))
    values = nn.Parameter(start.to(photos.device))
    groups = [{"params": [values], "lr": settings.rate}]
    losses = fitted(photos.photos, lambda photo: contrastive(photo, values), groups, settings.steps, settings.seed)
    low, high = np.quantile(positions, (0.01, 0.99), axis=0)
    places = torch.from_numpy(((positions - low) / np.maximum(high - low, 1e-9)).astype(np.float32)).to(photos.device)
    meant = _meant(photos, values)
    coarse_of = partial(_coarse, places=settings.positions * places, settings=settings)
    roots, coarse = _to_clusters(photos, values, meant, coarse_of, settings.coarse_steps, settings)
    fine_of = partial(_leaves, roots=roots, settings=settings)
    leaves, fine = _to_clusters(photos, values, meant, fine_of, settings.fine_steps, settings)
    features = named(photos, nn.functional.normalize(values.detach()), leaves)
    return Fitted(features.cpu().numpy(), leaves.cpu().numpy(), losses, coarse, fine)


def contrastive(photo: Photo, values: torch.Tensor) -> torch.Tensor:
    """Within masks the squared distance from their mean, between masks the inverse of that of their means.

    Source: OpenGaussian Eq. 1 and 2.
    """
    rendered = blended(photo, nn.functional.normalize(values))
    means = _means(rendered, photo.masks, photo.areas)
    away = (rendered - means.index_select(0, photo.masks)).square().sum(1, keepdim=True)
    within = _means(away, photo.masks, photo.areas)
    if len(means) < 2:
        return within.mean()
    apart = torch.pdist(means).square() + 1e-2
    return within.mean() + (1 / apart).mean()


def clusters(points: torch.Tensor, count: int, seed: int) -> torch.Tensor:
    """k-means: per point its cluster; starts drawn far apart with the seed. Fewer where there are fewer points."""
    generator = torch.Generator().manual_seed(seed)
    centers = points[torch.randperm(len(points), generator=generator)[:count].to(points.device)]
    for _ in range(ROUNDS):
        labels = torch.cat([torch.cdist(part, centers).argmin(1) for part in points.split(65536)])
        counts = torch.bincount(labels, minlength=len(centers))[:, None]
        sums = torch.zeros_like(centers).index_add(0, labels, points)
        centers = torch.where(counts > 0, sums / counts.clamp(min=1), centers)
    return labels


def _coarse(values: torch.Tensor, places: torch.Tensor, settings: Settings) -> torch.Tensor:
    return clusters(torch.cat([values, places], 1), settings.coarse, settings.seed)


def _leaves(values: torch.Tensor, roots: torch.Tensor, settings: Settings) -> torch.Tensor:
    leaves = torch.zeros_like(roots)
    for root in roots.unique():
        (members,) = torch.nonzero(roots == root, as_tuple=True)
        leaves[members] = root * settings.fine + clusters(values[members], settings.fine, settings.seed)
    return leaves


def _meant(photos: Photos, values: torch.Tensor) -> list[torch.Tensor]:
    """(k, 6) of each photo: what its masks are to look like, the means of what was learnt, rendered."""
    with torch.no_grad():
        unit = nn.functional.normalize(values)
        return [_means(blended(photo, unit), photo.masks, photo.areas) for photo in photos.photos]


def _to_clusters(
    photos: Photos,
    values: nn.Parameter,
    meant: Sequence[torch.Tensor],
    labels_of: Callable[[torch.Tensor], torch.Tensor],
    steps: int,
    settings: Settings,
) -> tuple[torch.Tensor, list[float]]:
    """The clusters, after features were fitted so that what their means render is what the masks look like.

    Clusters are found anew `REFRESHED` times; a feature takes the gradient of the mean that stands for it.

    Source: OpenGaussian Sec. 3.2, Eq. 4.
    """
    where = {id(photo): number for number, photo in enumerate(photos.photos)}
    losses: list[float] = []
    for turn in range(REFRESHED):
        with torch.no_grad():
            labels = labels_of(nn.functional.normalize(values))
        sizes = torch.bincount(labels).clamp(min=1)

        def loss(photo: Photo, labels: torch.Tensor = labels, sizes: torch.Tensor = sizes) -> torch.Tensor:
            unit = nn.functional.normalize(values)
            means = _means(unit.detach(), labels, sizes)
            quantised = unit + (means[labels] - unit.detach())
            return (blended(photo, quantised) - meant[where[id(photo)]].index_select(0, photo.masks)).abs().mean()

        group = {"params": [values], "lr": settings.rate}
        losses += fitted(photos.photos, loss, [group], max(1, steps // REFRESHED), settings.seed + turn)
    with torch.no_grad():
        return labels_of(nn.functional.normalize(values)), losses


def named(photos: Photos, values: torch.Tensor, leaves: torch.Tensor) -> torch.Tensor:
    """(k, d): per leaf the mean embedding of the masks that it is most like, photo by photo."""
    count = int(leaves.max()) + 1
    own = _means(values, leaves, torch.bincount(leaves, minlength=count).clamp(min=1))
    one_hot = nn.functional.one_hot(leaves, count).float()
    total = torch.zeros(count, photos.embeddings.shape[1], device=photos.device)
    for photo in photos.photos:
        means = _means(photo.weights @ values, photo.masks, photo.areas)
        shown = (photo.weights @ one_hot).argmax(1)  # the leaf that a pixel shows most of
        pixels = torch.bincount(shown, minlength=count)
        shared = torch.bincount(shown * len(means) + photo.masks, minlength=count * len(means)).reshape(count, -1)
        ious = shared / (pixels[:, None] + photo.areas - shared).clamp(min=1)
        distances = torch.cdist(own, means, p=1)
        like, best = (ious * (1 - distances).clamp(min=0)).max(1)
        counted = (pixels >= LEAST_PIXELS) & (like > 0)
        total[counted] += photos.embeddings[photo.numbers[best[counted]]]
    return nn.functional.normalize(total)


def _means(values: torch.Tensor, labels: torch.Tensor, sizes: torch.Tensor) -> torch.Tensor:
    """(k, c): of the rows of each label, of which there are `sizes`."""
    sums = torch.zeros(len(sizes), values.shape[1], device=values.device).index_add(0, labels, values)
    return sums / sizes[:, None]
