"""Centre pixels: of each view only the pixel that holds a Gaussian's projected centre has a say about it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int64

from drsplat import View
from drsplat.base.arrays import Indices, MaskIds
from drsplat.errors import InputError
from drsplat.field.evidence.aggregation import Sampling
from drsplat.kernels import SplatArrays, Triples, view_weights

PIXELS_AT_ONCE = 1 << 16  # times about a hundred contributors of 12 bytes: 80 MB


@dataclass(frozen=True)
class CentrePixels(Sampling):
    """W of the pixels that hold the Gaussians' centres, with all of their contributors, whatever their rank.

    Raises: InputError: topk or first_hits.
    """

    topk: int | None = None
    pixels: Literal["all", "centre"] = "centre"

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.topk, self.first_hits) != (None, None):
            raise InputError("centre pixels count whatever their rank: leave topk and first_hits at None")

    def triples(self, splats: SplatArrays, view: View, mask_ids: MaskIds, threads: int = 0) -> Triples:
        return centre_weights(splats, view, mask_ids, threads=threads)


def centre_weights(splats: SplatArrays, view: View, mask_ids: MaskIds, *, threads: int = 0) -> Triples:
    """Per Gaussian its blending weight alpha T at the pixel of its centre, and the mask there.

    At most one entry per Gaussian; none where it adds nothing there, or where no mask is.

    Source: Occam's LGS (BMVC 2025).  Twin: tests/project/test_benchmark_aggregators.py::slow_centre_weights.
    """
    pixels = centre_pixels(splats, view)
    wanted = np.unique(pixels[pixels >= 0])
    wanted = wanted[mask_ids.ravel()[wanted] >= 0]
    chunks = [
        _weights_at(splats, view, pixels, wanted[begin : begin + PIXELS_AT_ONCE], threads)
        for begin in range(0, len(wanted), PIXELS_AT_ONCE)
    ]
    ids = np.concatenate([chunk[0] for chunk in chunks] or [np.empty(0, np.uint32)])
    weights = np.concatenate([chunk[1] for chunk in chunks] or [np.empty(0, np.float32)])
    order = np.argsort(ids, kind="stable")
    ids = ids[order]
    return Triples(ids, mask_ids.ravel()[pixels[ids]], weights[order])


def centre_pixels(splats: SplatArrays, view: View) -> Indices:
    """Per Gaussian the pixel (row by row) that its centre projects into; -1 outside or behind."""
    pose, K = view.relative_to(splats.origin).cam_from_world, view.K
    x, y, z = (pose[row, :3] @ splats.means.astype(np.float64) + pose[row, 3] for row in range(3))
    ahead = z > 0
    depth = np.where(ahead, z, 1)
    column = np.floor(K[0, 0] * x / depth + K[0, 2])
    row = np.floor(K[1, 1] * y / depth + K[1, 2])
    inside = ahead & (column >= 0) & (column < view.width) & (row >= 0) & (row < view.height)
    return np.where(inside, row * view.width + column, -1).astype(np.int64)


def _weights_at(
    splats: SplatArrays, view: View, pixels: Indices, chosen: Int64[np.ndarray, " p"], threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Gaussians whose centre is in one of the chosen pixels, and their weights there."""
    # Every pixel is a mask of its own, so that W has its contributors one by one.
    own = np.full(view.width * view.height, -1, np.int32)
    own[chosen] = np.arange(len(chosen), dtype=np.int32)
    found = view_weights(splats, view, own.reshape(view.height, view.width), None, threads=threads)
    at_centre = pixels[found.gaussian_ids] == chosen[found.mask_ids]
    return found.gaussian_ids[at_centre], found.weights[at_centre]
