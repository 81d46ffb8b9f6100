"""What a pair of touching regions looks like, as numbers for the rule that merges."""

import numpy as np

from drsplat.base.arrays import Float64
from drsplat.kernels.photo_regions import (
    AREA,
    AROUND,
    BINS_PER_CHANNEL,
    BORDER_STEPS,
    FRAME,
    HISTOGRAM,
    LAB_STEPS,
    LENGTH,
    MEAN,
    SEEN,
    SQUARE,
    STEP,
    STEP_CHROMA,
    TEXTURE,
    TRAIT,
    TRAIT_SQUARE,
    TRAIT_STEP,
    TRAIT_STEPS,
)

OF_NETWORK = 6  # the last features: what the network sees
_NOISE = 1.0  # CIELAB units that even flat colours differ by


def pair_features(
    sums: Float64[np.ndarray, "2 e c"],
    boxes: Float64[np.ndarray, "2 e 4"],
    borders: Float64[np.ndarray, "e 5"],
    pixels: int,
) -> Float64[np.ndarray, "e f"]:
    """One row per pair; the smaller region counts as first, whichever comes first.

    sums, boxes, borders: as in RegionGraph, of both regions and their border. pixels: of the image.
    """
    swapped = sums[0, :, AREA] > sums[1, :, AREA]
    sums = np.where(swapped[:, None], sums[::-1], sums)
    boxes = np.where(swapped[:, None], boxes[::-1], boxes)
    colors = _colors(sums, borders)
    shapes = _shapes(sums, boxes, borders, pixels)
    return np.concatenate([colors, shapes, _seen(sums, borders)], 0).T


def _seen(sums: Float64[np.ndarray, "2 e c"], borders: Float64[np.ndarray, "e 5"]) -> Float64[np.ndarray, "f e"]:
    """What the network says of the border, and how far apart and how spread its traits of the two regions are."""
    area, sides = sums[..., AREA], borders[:, LENGTH]
    mean = sums[..., TRAIT] / (area[..., None] * TRAIT_STEPS)
    spread = np.maximum(sums[..., TRAIT_SQUARE] / (area * TRAIT_STEPS**2) - np.square(mean).sum(-1), 0)
    apart = np.square(mean[0] - mean[1]).sum(-1)
    rows = [
        borders[:, SEEN] / (2 * BORDER_STEPS * sides), np.sqrt(borders[:, TRAIT_STEP] / (TRAIT_STEPS * sides)),
        np.sqrt(apart), apart / (1 + spread[0] + spread[1]), np.sqrt(spread[0]), np.sqrt(spread[1]),
    ]  # fmt: skip
    return np.stack(rows)


def _colors(sums: Float64[np.ndarray, "2 e c"], borders: Float64[np.ndarray, "e 5"]) -> Float64[np.ndarray, "f e"]:
    area = sums[..., AREA, None]
    mean = sums[..., MEAN] / (area * LAB_STEPS)
    spread = sums[..., SQUARE] / (area * LAB_STEPS**2) - mean**2
    deviation = np.sqrt(np.maximum(spread, 0))
    apart = np.abs(mean[0] - mean[1])
    chroma = np.hypot(apart[:, 1], apart[:, 2])
    color = np.hypot(apart[:, 0], chroma)
    strength = np.hypot(mean[..., 1], mean[..., 2])
    rough = deviation.sum(-1)
    shade = mean[..., 1:] / (mean[..., :1] + 10)  # of one paint in light and in shadow nearly equal
    steps = borders[:, [STEP, STEP_CHROMA]] / (borders[:, LENGTH, None] * LAB_STEPS)
    shares = sums[..., HISTOGRAM] / area
    unlike = np.abs(shares[0] - shares[1]).reshape(len(area[0]), 3, BINS_PER_CHANNEL).sum(2)
    texture = sums[..., TEXTURE] / (sums[..., AREA] * LAB_STEPS)
    noise = rough[0] + rough[1] + _NOISE
    rows = [
        np.sqrt(color), np.sqrt(apart[:, 0]), np.sqrt(chroma), mean[0, :, 0] - mean[1, :, 0],
        strength[0] - strength[1], np.linalg.norm(shade[0] - shade[1], axis=1),
        np.sqrt(steps[:, 0]), np.sqrt(steps[:, 1]), color / noise, steps[:, 0] / noise,
        np.log1p(rough[0]), np.log1p(rough[1]), np.log1p(texture[0]), np.log1p(texture[1]),
        mean[0, :, 0], mean[1, :, 0], strength[0], strength[1],
    ]  # fmt: skip
    return np.concatenate([np.stack(rows), unlike.T])


def _shapes(
    sums: Float64[np.ndarray, "2 e c"],
    boxes: Float64[np.ndarray, "2 e 4"],
    borders: Float64[np.ndarray, "e 5"],
    pixels: int,
) -> Float64[np.ndarray, "f e"]:
    area, around, frame = sums[..., AREA], sums[..., AROUND], sums[..., FRAME]
    touching = borders[:, LENGTH]
    both = np.minimum(boxes[0], boxes[1])
    fill, filled = area / _box_area(boxes), area.sum(0) / _box_area(both)
    shorter = np.minimum(around[0], around[1])
    rows = [
        np.log(area[0] / pixels), np.log(area[1] / pixels), touching / around[0],
        touching / around[1], touching / shorter, np.log(touching / np.sqrt(area[0])),
        np.log((around[0] + frame[0]) / np.sqrt(area[0])),
        np.log((around[1] + frame[1]) / np.sqrt(area[1])),
        fill[0], fill[1], filled, filled - fill[1],
        np.sqrt(frame[0] / np.sqrt(pixels)), np.sqrt(frame[1] / np.sqrt(pixels)),
        _box_area(both) / _box_area(boxes[1]) - 1,
    ]  # fmt: skip
    return np.stack(rows)


def _box_area(boxes: Float64[np.ndarray, "*e 4"]) -> Float64[np.ndarray, "*e"]:
    return np.asarray((boxes[..., 0] + boxes[..., 2]) * (boxes[..., 1] + boxes[..., 3]))
