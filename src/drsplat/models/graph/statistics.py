"""What is known of regions and of the borders between them: sums, so that those of a union are their sums."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int32, Int64

from .network import TRAITS, Sight
from .regions import LAB_STEPS

BINS = 12  # of each channel's histogram
AREA, MEAN, SQUARE, FRAME, AROUND, TEXTURE = 0, slice(1, 4), slice(4, 7), 7, 8, 9
HISTOGRAM = slice(10, 10 + 3 * BINS)
TRAIT = slice(HISTOGRAM.stop, HISTOGRAM.stop + TRAITS)
TRAIT_SQUARE = TRAIT.stop
COLUMNS = TRAIT_SQUARE + 1
LENGTH, STEP, STEP_CHROMA, SEEN, TRAIT_STEP = range(5)
_RANGES = ((0.0, 100.0), (-60.0, 60.0), (-60.0, 60.0))


@dataclass(frozen=True, eq=False)
class RegionGraph:
    """Regions of an image and which of them touch. All numbers are whole, so sums do not depend on order.

    sums: columns as named above: pixels, colours and their squares, pixels at the image's frame, length
    of the border to other regions, texture, histograms; colours in steps of CIELAB. boxes: x0, y0, -x1, -y1.
    pairs: first below second. borders: length in pixel sides, sum of colour steps across, of chroma alone.
    """

    pixels: int
    sums: Float64[np.ndarray, "n c"]
    boxes: Float64[np.ndarray, "n 4"]
    pairs: Int64[np.ndarray, "e 2"]
    borders: Float64[np.ndarray, "e 5"]


def region_graph(labels: Int64[np.ndarray, "h w"], lab: Int32[np.ndarray, "h w 3"], sight: Sight) -> RegionGraph:
    count = int(labels.max()) + 1
    pairs, borders = _borders(labels, lab, sight)
    sums = np.zeros((count, COLUMNS))
    flat, colors = labels.ravel(), lab.reshape(-1, 3)
    sums[:, AREA] = np.bincount(flat, minlength=count)
    for channel in range(3):
        values = colors[:, channel].astype(np.float64)
        sums[:, MEAN.start + channel] = np.bincount(flat, values, count)
        sums[:, SQUARE.start + channel] = np.bincount(flat, values**2, count)
        sums[:, _histogram_columns(channel)] = _histograms(flat, values, channel, count)
    frame = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    sums[:, FRAME] = np.bincount(frame, minlength=count)
    for side in (0, 1):
        sums[:, AROUND] += np.bincount(pairs[:, side], borders[:, LENGTH], count)
    sums[:, TEXTURE] = np.bincount(flat, _texture(lab[..., 0]).ravel(), count)
    traits = sight.traits.reshape(-1, TRAITS).astype(np.float64)
    for k in range(TRAITS):
        sums[:, TRAIT.start + k] = np.bincount(flat, traits[:, k], count)
    sums[:, TRAIT_SQUARE] = np.bincount(flat, (traits**2).sum(1), count)
    return RegionGraph(labels.size, sums, _boxes(labels, count), pairs, borders)


def _histogram_columns(channel: int) -> slice:
    return slice(HISTOGRAM.start + channel * BINS, HISTOGRAM.start + (channel + 1) * BINS)


def _histograms(
    flat: Int64[np.ndarray, " p"], values: Float64[np.ndarray, " p"], channel: int, count: int
) -> Int64[np.ndarray, "n b"]:
    low, high = _RANGES[channel]
    places = (values / LAB_STEPS - low) * (BINS / (high - low))
    bins = np.clip(places.astype(np.int64), 0, BINS - 1)
    return np.bincount(flat * BINS + bins, minlength=count * BINS).reshape(count, BINS)


def _texture(lightness: Int32[np.ndarray, "h w"]) -> Float64[np.ndarray, "h w"]:
    """How unlike its left and upper neighbours a pixel is, in steps of CIELAB."""
    texture = np.zeros(lightness.shape)
    texture[:, 1:] += np.abs(np.diff(lightness, axis=1))
    texture[1:] += np.abs(np.diff(lightness, axis=0))
    return texture


def _boxes(labels: Int64[np.ndarray, "h w"], count: int) -> Float64[np.ndarray, "n 4"]:
    from scipy.ndimage import find_objects

    boxes = np.zeros((count, 4))
    for i, (rows, columns) in enumerate(find_objects(labels + 1)):
        boxes[i] = columns.start, rows.start, -columns.stop, -rows.stop
    return boxes


def _borders(
    labels: Int64[np.ndarray, "h w"], lab: Int32[np.ndarray, "h w 3"], sight: Sight
) -> tuple[Int64[np.ndarray, "e 2"], Float64[np.ndarray, "e 5"]]:
    """Touching regions and the sums over their border: see RegionGraph."""
    turned = Sight(sight.borders.T, sight.traits.transpose(1, 0, 2))
    across, down = _sides(labels, lab, sight), _sides(labels.T, lab.transpose(1, 0, 2), turned)
    ends = np.concatenate([across[0], down[0]])
    steps = np.concatenate([across[1], down[1]])
    count = int(labels.max()) + 1
    keys, owner = np.unique(ends.min(1) * count + ends.max(1), return_inverse=True)
    sums = [np.bincount(owner, column, len(keys)).astype(float) for column in steps.T]  # of nothing: whole
    return np.stack([keys // count, keys % count], 1), np.stack(sums, 1)


def _sides(
    labels: Int64[np.ndarray, "h w"], lab: Int32[np.ndarray, "h w 3"], sight: Sight
) -> tuple[Int64[np.ndarray, "s 2"], Float64[np.ndarray, "s 5"]]:
    """Pixel sides between two columns where regions meet: both regions, and 1, steps of colour, of chroma, what the
    network says of the two pixels, step of traits.

    Steps are taken one pixel farther out on both sides, since an edge is blurred over two pixels.
    """
    y, x = np.nonzero(labels[:, 1:] != labels[:, :-1])
    ends = np.stack([labels[y, x], labels[y, x + 1]], 1)
    inner, outer = np.maximum(x - 1, 0), np.minimum(x + 2, labels.shape[1] - 1)
    square = (lab[y, inner] - lab[y, outer]).astype(np.float64) ** 2
    step, chroma = np.rint(np.sqrt(square.sum(1))), np.rint(np.sqrt(square[:, 1:].sum(1)))
    apart = np.square((sight.traits[y, inner] - sight.traits[y, outer]).astype(np.float64)).sum(1)
    seen = (sight.borders[y, x] + sight.borders[y, x + 1]).astype(np.float64)
    return ends, np.stack([np.ones(len(y)), step, chroma, seen, np.rint(np.sqrt(apart))], 1)
