"""Per-Gaussian values fitted by rendering them, geometry and opacity frozen: what the rendering rivals share.

With frozen Gaussians a rendered pixel is a fixed weighted sum of their values, so a photo is a sparse matrix of
blending weights, made once, and rendering and its gradient are products with it and with its transpose: the
rasteriser's own numbers, forward and backward, for any number of channels.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_array

from drsplat import Gaussians, View, ViewFeatures
from drsplat.kernels import splat_arrays

from ..blending import Blending, blending_of
from .stepping import adam, means_of, stepping

WIDTH = 320  # pixels of a photo that is fitted; the papers fit whole ones
CONTRIBUTORS = 32  # of a pixel, the largest; what is left out is the dimmest tail
TRACE = 50  # numbers that are kept of a loss


class Photo(NamedTuple):
    """A photo's pixels that a mask covers, on the device that fits.

    weights: blending weights, pixels x Gaussians, sparse; back: transposed. masks: (p,) per pixel its mask among those
    that the photo shows. numbers: (k,) of these, the rows of their embeddings. areas: (k,) their pixels.
    """

    weights: torch.Tensor
    back: torch.Tensor
    masks: torch.Tensor
    numbers: torch.Tensor
    areas: torch.Tensor


class Photos(NamedTuple):
    """embeddings: (m, d) of all masks, which the photos count through. seen: (N,) whether a pixel shows a Gaussian."""

    photos: tuple[Photo, ...]
    embeddings: torch.Tensor
    seen: np.ndarray

    @property
    def num_gaussians(self) -> int:
        return len(self.seen)

    @property
    def device(self) -> torch.device:
        return self.embeddings.device


def photos_of(
    gaussians: Gaussians, views: Mapping[View, ViewFeatures], width: int = WIDTH, threads: int = 0, device: str = "cpu"
) -> Photos:
    splats, seen = splat_arrays(gaussians), np.zeros(len(gaussians), bool)
    photos, first = [], 0
    for view, features in views.items():
        found = blending_of(splats, view, features, width, CONTRIBUTORS, threads)
        seen[found.weights.indices] = True
        photos.append(_photo(found, first, device))
        first += len(features.embeddings)
    embeddings = np.concatenate([features.embeddings for features in views.values()])
    return Photos(tuple(photos), torch.from_numpy(np.asarray(embeddings, np.float32)).to(device), seen)


def _photo(found: Blending, first: int, device: str) -> Photo:
    numbers, masks, areas = np.unique(found.masks.astype(np.int64), return_inverse=True, return_counts=True)
    parts = (torch.from_numpy(part).to(device) for part in (masks, numbers + first, areas))
    return Photo(_sparse(found.weights, device), _sparse(csr_array(found.weights.T), device), *parts)


def _sparse(matrix: csr_array, device: str) -> torch.Tensor:
    starts, columns = (torch.from_numpy(part.astype(np.int32)) for part in (matrix.indptr, matrix.indices))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that the layout is in beta
        return torch.sparse_csr_tensor(starts, columns, torch.from_numpy(matrix.data), matrix.shape, device=device)


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, photo: Photo) -> torch.Tensor:
        ctx.photo = photo
        return photo.weights @ values

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        return ctx.photo.back @ gradients[0], None


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
    device = groups[0]["params"][0].device
    optimizer = adam(groups, device, eps=1e-15)
    steppers = [stepping(optimizer, partial(loss, photo), device) for photo in photos]
    losses = torch.zeros(steps, device=device)
    for step, number in enumerate(_in_turn(len(photos), steps, seed)):
        losses[step] = steppers[number]()
    return means_of(losses, TRACE)


def _in_turn(count: int, steps: int, seed: int) -> Iterator[int]:
    rng, left = np.random.default_rng(seed), []
    for _ in range(steps):
        left = left or rng.permutation(count).tolist()
        yield left.pop()
