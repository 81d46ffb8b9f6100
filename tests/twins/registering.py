"""The float64 twin of the native kernels: the same functions in NumPy, slow and plain.

It decides what the native kernels must compute. It also knows where it cannot decide: a float32
kernel may fall on the other side of a discontinuity (the 1/255 cut, the transmittance stop, a tie),
so `on_boundary` marks the pixels where rounding alone can change who contributes.

Source: Kerbl et al. 2023 (3D Gaussian Splatting) Eq. 3; Dr. Splat Sec. A for top-k.
"""

from typing import NamedTuple

import numpy as np

from drsplat.base.arrays import AnyPoints, Float, Float64, Int, Mask, MaskIds, Points
from drsplat.scene.views import View

from .compositing import Contributors, contributors, rank_in_pixel, select
from .projection import Splats

TIE_BAND = 1e-5  # relative difference of weights below which float32 may order them otherwise


class Triples(NamedTuple):
    """Sorted by (gaussian, mask); every pair once; weights > 0."""

    gaussian_ids: Int[np.ndarray, " t"]
    mask_ids: Int[np.ndarray, " t"]
    weights: Float64[np.ndarray, " t"]


class Contributions(NamedTuple):
    """Per pixel, descending in weight, ties front to back; padding: id -1, weight 0."""

    ids: Int[np.ndarray, "h w k"]
    weights: Float64[np.ndarray, "h w k"]


class Rendering(NamedTuple):
    """Composited channels, alpha = 1 - transmittance, and expected depth (0 where alpha is 0)."""

    channels: Float64[np.ndarray, "h w c"]
    alpha: Float64[np.ndarray, "h w"]
    depth: Float64[np.ndarray, "h w"]


def view_weights(
    splats: Splats, view: View, mask_ids: MaskIds, topk: int | None = 40, *, first_hits: int | None = None
) -> Triples:
    """Sum, per Gaussian and mask, the blending weights over the mask's pixels.

    Pixels of mask -1 contribute nothing. topk None keeps every contributor of a pixel.
    """
    return mask_sums(largest(contributors(splats, view, first_hits), topk), mask_ids)


def topk_contributions(splats: Splats, view: View, k: int, *, first_hits: int | None = None) -> Contributions:
    """Return the k largest blending weights of each pixel and the Gaussians that own them."""
    return pixel_table(largest(contributors(splats, view, first_hits), k), k)


def render_channels(
    splats: Splats, view: View, values: Float[np.ndarray, "n c"], background: Float[np.ndarray, " c"] | None = None
) -> Rendering:
    """Composite per-Gaussian values: sum of w_i v_i, plus the background seen through the rest."""
    return weighted_sums(contributors(splats, view), values, background)


def sh_colors(sh: Float[np.ndarray, "n k 3"], means: AnyPoints, center: Float[np.ndarray, " 3"]) -> Points:
    """Colours seen from `center`: max(0, 0.5 + SH(unit direction from the camera to the mean))."""
    directions = means.astype(np.float64) - center
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = sh_basis(directions)[:, : sh.shape[1]]
    return np.asarray(np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", basis, sh.astype(np.float64))))


def sh_basis(directions: Points) -> Float64[np.ndarray, "n 16"]:
    """Real spherical harmonics of degrees 0-3, Condon-Shortley phase included as in 3DGS files."""
    x, y, z = directions.T
    basis = [
        np.full_like(x, np.sqrt(1 / 4)),
        -np.sqrt(3 / 4) * y,
        np.sqrt(3 / 4) * z,
        -np.sqrt(3 / 4) * x,
        np.sqrt(15 / 4) * x * y,
        -np.sqrt(15 / 4) * y * z,
        np.sqrt(5 / 16) * (3 * z * z - 1),
        -np.sqrt(15 / 4) * x * z,
        np.sqrt(15 / 16) * (x * x - y * y),
        -np.sqrt(35 / 32) * y * (3 * x * x - y * y),
        np.sqrt(105 / 4) * x * y * z,
        -np.sqrt(21 / 32) * y * (5 * z * z - 1),
        np.sqrt(7 / 16) * z * (5 * z * z - 3),
        -np.sqrt(21 / 32) * x * (5 * z * z - 1),
        np.sqrt(105 / 16) * z * (x * x - y * y),
        -np.sqrt(35 / 32) * x * (x * x - 3 * y * y),
    ]
    return np.asarray(np.stack(basis, axis=1) / np.sqrt(np.pi))


def largest(seen: Contributors, k: int | None) -> Contributors:
    """Keep the k largest weights of each pixel, still front to back; of equal ones the nearer."""
    return seen if k is None else select(seen, _weight_rank(seen) < k)


def pixel_table(seen: Contributors, k: int) -> Contributions:
    """Lay out at most k contributors per pixel in falling weight."""
    shape = (*seen.transmittance.shape, k)
    ids, weights = np.full(shape, -1), np.zeros(shape)
    rows, columns = np.divmod(seen.pixels, shape[1])
    place = (rows, columns, _weight_rank(seen))
    ids[place], weights[place] = seen.ids, seen.weights
    return Contributions(ids, weights)


def weighted_sums(
    seen: Contributors, values: Float[np.ndarray, "n c"], background: Float[np.ndarray, " c"] | None = None
) -> Rendering:
    """Sum weight times value over the contributors of each pixel."""
    shape = seen.transmittance.shape

    def composite(column: Float64[np.ndarray, " e"]) -> Float64[np.ndarray, "h w"]:
        return np.bincount(seen.pixels, seen.weights * column, shape[0] * shape[1]).reshape(shape)

    columns = values.astype(np.float64).T
    channels = np.stack([composite(column[seen.ids]) for column in columns], axis=-1)
    if background is not None:
        channels += seen.transmittance[..., None] * background
    alpha = composite(np.ones(len(seen.ids)))
    depth = np.divide(composite(seen.depths), alpha, out=np.zeros(shape), where=alpha > 0)
    return Rendering(channels, alpha, depth)


def mask_sums(seen: Contributors, mask_ids: MaskIds) -> Triples:
    """Sum the weights of each (Gaussian, mask) pair."""
    masks = mask_ids.ravel()[seen.pixels].astype(np.int64)
    covered = masks >= 0
    stride = int(masks.max(initial=0)) + 1
    keys, inverse = np.unique(seen.ids[covered] * stride + masks[covered], return_inverse=True)
    weights = np.bincount(inverse, seen.weights[covered], len(keys))
    return Triples(keys // stride, keys % stride, weights)


def on_boundary(seen: Contributors, k: int | None) -> Mask:
    """Mark the pixels whose k largest contributors a float32 kernel may choose differently."""
    tied = np.zeros(seen.unsure.shape, bool)
    if k is not None:
        order, rank = _by_weight(seen), rank_in_pixel(seen.pixels)
        runner_up = np.flatnonzero(rank == k)
        last, first_left_out = seen.weights[order][[runner_up - 1, runner_up]]
        close = last - first_left_out <= TIE_BAND * last
        tied.ravel()[seen.pixels[runner_up[close]]] = True
    return seen.unsure | tied


def _by_weight(seen: Contributors) -> Int[np.ndarray, " e"]:
    """The order that sorts each pixel by falling weight; stable, so ties stay front to back."""
    return np.lexsort((-seen.weights, seen.pixels))


def _weight_rank(seen: Contributors) -> Int[np.ndarray, " e"]:
    rank = np.empty(len(seen.pixels), np.int64)
    rank[_by_weight(seen)] = rank_in_pixel(seen.pixels)
    return rank
