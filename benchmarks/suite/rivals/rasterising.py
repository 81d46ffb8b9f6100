"""Per-Gaussian values fitted by rendering them, geometry and opacity frozen: what the rendering rivals share.

With frozen Gaussians a rendered pixel is a fixed weighted sum of their values, so a photo is a sparse matrix of
blending weights, made once, and rendering and its gradient are products with it and with its transpose: the
rasteriser's own numbers, forward and backward, for any number of channels.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float32, Int64
from scipy.sparse import csr_array

from drsplat import Gaussians, View, ViewFeatures
from drsplat.kernels import splat_arrays

from ..blending import blending_of

WIDTH = 320  # pixels of a photo that is fitted; the papers fit whole ones
CONTRIBUTORS = 32  # of a pixel, the largest; what is left out is the dimmest tail
TRACE = 50  # numbers that are kept of a loss


class Photo(NamedTuple):
    """A photo's pixels that a mask covers.

    weights: blending weights, pixels x Gaussians; back: transposed. masks: per pixel the row of its mask's embedding.
    """

    weights: csr_array
    back: csr_array
    masks: Int64[np.ndarray, " p"]


class Photos(NamedTuple):
    """embeddings: of all masks, which the photos count through."""

    photos: tuple[Photo, ...]
    embeddings: Float32[np.ndarray, "m d"]
    num_gaussians: int

    def seen(self) -> np.ndarray:
        """Per Gaussian whether any pixel shows it."""
        found = np.zeros(self.num_gaussians, bool)
        for photo in self.photos:
            found[photo.weights.indices] = True
        return found


def photos_of(gaussians: Gaussians, seen: Mapping[View, ViewFeatures], width: int = WIDTH, threads: int = 0) -> Photos:
    splats, photos, first = splat_arrays(gaussians), [], 0
    for view, features in seen.items():
        weights, masks = blending_of(splats, view, features, width, CONTRIBUTORS, threads)
        photos.append(Photo(weights, csr_array(weights.T), masks.astype(np.int64) + first))
        first += len(features.embeddings)
    embeddings = np.concatenate([features.embeddings for features in seen.values()])
    return Photos(tuple(photos), np.asarray(embeddings, np.float32), len(gaussians))


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, photo: Photo) -> torch.Tensor:
        ctx.photo = photo
        return torch.from_numpy(photo.weights @ values.detach().numpy())

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        return torch.from_numpy(ctx.photo.back @ gradients[0].numpy()), None


def blended(photo: Photo, values: torch.Tensor) -> torch.Tensor:
    """(N, C) values of Gaussians, rendered over zero at the pixels of a photo: (p, C)."""
    rendered: torch.Tensor = _Blend.apply(values, photo)
    return rendered


def fitted(
    photos: Sequence[Photo],
    loss: Callable[[Photo], torch.Tensor],
    groups: Sequence[dict[str, Any]],
    steps: int,
    seed: int,
) -> list[float]:
    """Adam, a photo a step, all photos before any comes again. The mean losses of up to `TRACE` stretches of steps.

    groups: of parameters with their rates, as torch takes them.
    """
    optimizer = torch.optim.Adam(list(groups), eps=1e-15)
    losses = np.zeros(steps)
    for step, photo in enumerate(_in_turn(photos, steps, seed)):
        found = loss(photo)
        optimizer.zero_grad()
        found.backward()
        optimizer.step()
        losses[step] = float(found.detach())
    return [float(part.mean()) for part in np.array_split(losses, min(TRACE, steps)) if len(part)]


def _in_turn(photos: Sequence[Photo], steps: int, seed: int) -> Iterator[Photo]:
    rng, left = np.random.default_rng(seed), []
    for _ in range(steps):
        left = left or rng.permutation(len(photos)).tolist()
        yield photos[left.pop()]
