"""Front-to-back compositing in float64, tile by tile: who contributes to which pixel, and how much.

Source: Kerbl et al. 2023 (3D Gaussian Splatting) Eq. 3 and its rasterizer's thresholds.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drsplat.base.arrays import Bool, Doubles, Flags, Float, Float64, Int, Int64, Mask
from drsplat.scene.views import View

from .projection import MIN_ALPHA, ROUNDING, TILE, Projection, Splats, project

MAX_ALPHA = 0.99
MIN_TRANSMITTANCE = 1e-4

# Relative widths of the bands in which float32 may decide otherwise.
ALPHA_BAND = 1e-4
TRANSMITTANCE_BAND = 1e-3


class Contributors(NamedTuple):
    """Every (pixel, Gaussian) pair with its blending weight: pixel by pixel, front to back.

    pixels: row * width + column, ascending. depths: camera z of the Gaussian. transmittance: what is left behind the
    last contributor. unsure: pixels where float32 rounding may change the contributors or their order.
    """

    pixels: Int[np.ndarray, " e"]
    ids: Int[np.ndarray, " e"]
    weights: Float64[np.ndarray, " e"]
    depths: Float64[np.ndarray, " e"]
    transmittance: Float64[np.ndarray, "h w"]
    unsure: Mask


def contributors(splats: Splats, view: View, first_hits: int | None = None) -> Contributors:
    """List every contributor of every pixel; with first_hits, only the first n front to back."""
    projection = project(splats, view)
    transmittance = np.ones((view.height, view.width))
    unsure = np.zeros((view.height, view.width), bool)
    parts = []
    for rows, columns in _tiles(view):
        members, weights, transmittance[rows, columns], unsure[rows, columns] = _composite(projection, rows, columns)
        row, column, place = np.nonzero(np.moveaxis(weights, 0, -1))
        pixels = (rows.start + row) * view.width + columns.start + column
        parts.append((pixels, members[place], weights[place, row, column]))
    pixels, places, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(pixels, kind="stable")
    pixels, places, weights = pixels[order], places[order], weights[order]
    unsure.ravel()[_equal_depth_pixels(projection, pixels, places)] = True
    ids, depths = projection.ids[places], projection.depths[places]
    seen = Contributors(pixels, ids, weights, depths, transmittance, unsure)
    return seen if first_hits is None else select(seen, rank_in_pixel(pixels) < first_hits)


def _composite(
    projection: Projection, rows: slice, columns: slice
) -> tuple[Int[np.ndarray, " m"], Float64[np.ndarray, "m h w"], np.ndarray, np.ndarray]:
    """One tile: its Gaussians, their weights, the transmittance behind them, the unsure pixels."""
    members = np.flatnonzero(_covers(projection.possible_tiles, rows, columns))
    nominal = _covers(projection.tiles[members], rows, columns)[:, None, None]
    certain = _covers(projection.certain_tiles[members], rows, columns)[:, None, None]
    alphas, band = _alphas(projection, members, rows, columns)

    hits = nominal & (alphas >= MIN_ALPHA)
    after = np.cumprod(np.where(hits, 1 - alphas, 1.0), axis=0)
    before = np.concatenate([np.ones((1, *after.shape[1:])), after])[:-1]
    stopped = after < MIN_TRANSMITTANCE
    weights = np.where(hits & ~stopped, alphas * before, 0.0)
    transmittance = np.where(stopped, 1.0, after).min(axis=0, initial=1.0)

    with np.errstate(divide="ignore"):
        headroom = np.log(alphas / MIN_ALPHA)
    at_cut = np.abs(headroom) <= band
    at_tile_edge = ~certain & (headroom >= -band)
    at_stop = hits & (np.abs(after / MIN_TRANSMITTANCE - 1) <= TRANSMITTANCE_BAND)
    reached = before >= MIN_TRANSMITTANCE * (1 - TRANSMITTANCE_BAND)
    unsure = np.any(reached & (at_cut | at_tile_edge | at_stop), axis=0)
    return members, weights, transmittance, unsure


def _alphas(
    projection: Projection, members: Int[np.ndarray, " m"], rows: slice, columns: slice
) -> tuple[Float64[np.ndarray, "m h w"], Float64[np.ndarray, "m h w"]]:
    """Opacity times falloff at the pixel centres, and the float32 band of its logarithm."""

    def column(values: Doubles) -> Float64[np.ndarray, "m 1 1"]:
        return values[members, None, None]

    dx = np.arange(columns.start, columns.stop) + 0.5 - column(projection.centers[:, 0])
    dy = np.arange(rows.start, rows.stop)[:, None] + 0.5 - column(projection.centers[:, 1])
    xx, xy, yy = (column(entry) for entry in projection.conics.T)
    gx, gy = xx * dx + xy * dy, xy * dx + yy * dy
    exponent = 0.5 * (gx * dx + gy * dy)
    alphas = np.minimum(MAX_ALPHA, column(projection.opacities) * np.exp(-exponent))

    x_error, y_error = (column(entry) for entry in projection.center_error.T)
    error = column(projection.covariance_error) * (gx * gx + gy * gy)
    error += np.abs(gx) * x_error + np.abs(gy) * y_error + ROUNDING * column(projection.cancellation) * exponent
    return alphas, np.maximum(ALPHA_BAND, error + column(projection.dimming_error))


def _covers(rectangles: Int[np.ndarray, "n 4"], rows: slice, columns: slice) -> Flags:
    tile = np.array([columns.start, rows.start]) // TILE
    inside = (rectangles[:, :2] <= tile) & (tile < rectangles[:, 2:])
    return np.asarray(inside.all(axis=1))


def _tiles(view: View) -> Iterator[tuple[slice, slice]]:
    for top in range(0, view.height, TILE):
        for left in range(0, view.width, TILE):
            bottom, right = min(top + TILE, view.height), min(left + TILE, view.width)
            yield slice(top, bottom), slice(left, right)


def _equal_depth_pixels(
    projection: Projection, pixels: Int[np.ndarray, " e"], places: Int[np.ndarray, " e"]
) -> Int[np.ndarray, " p"]:
    """Pixels where two consecutive contributors could change places."""
    depths, error = projection.depths[places], projection.depth_error[places]
    close = np.diff(depths) <= error[1:] + error[:-1]
    return np.asarray(pixels[1:][close & (np.diff(pixels) == 0)])


def select(seen: Contributors, index: Bool[np.ndarray, " e"]) -> Contributors:
    """The entries of `index`; what the pixels let through and whether they are unsure stays."""
    pixels, ids, weights, depths = (column[index] for column in seen[:4])
    return Contributors(pixels, ids, weights, depths, seen.transmittance, seen.unsure)


def rank_in_pixel(pixels: Int[np.ndarray, " e"]) -> Int[np.ndarray, " e"]:
    """Position of each entry within its run of equal pixels."""
    return np.arange(len(pixels)) - np.searchsorted(pixels, pixels)


def heaviest_labels(
    ids: Int[np.ndarray, "h w k"], weights: Float[np.ndarray, "h w k"], labels: Int[np.ndarray, " n"]
) -> Int64[np.ndarray, "h w"]:
    """Return the label with the largest sum of weights in each pixel, of equal ones the first; an id of -1 has -1."""
    of = np.where(ids < 0, -1, np.append(labels, -1)[ids])
    shares = np.stack([np.where(of == of[..., [k]], weights, 0).sum(2) for k in range(ids.shape[2])], axis=2)
    return np.take_along_axis(of, shares.argmax(2)[..., None], axis=2)[..., 0].astype(np.int64)
