"""The twins of `kernels.photo_regions`: colours of scikit-image, a union-find in plain Python, sums of NumPy."""

import numpy as np

from drsplat.base.arrays import Float64, Int32, Int64, MaskIds, Pixels
from drsplat.kernels.photo_regions import (
    AREA,
    AROUND,
    BINS_PER_CHANNEL,
    COLUMNS,
    FRAME,
    HISTOGRAM,
    LAB_STEPS,
    LENGTH,
    MEAN,
    SQUARE,
    TEXTURE,
    TRAIT,
    TRAIT_SQUARE,
    TRAITS,
    RegionGraph,
    Sight,
)

SIGMA = 0.5  # pixels that are blurred before
_RANGES = ((0.0, 100.0), (-60.0, 60.0), (-60.0, 60.0))


def lab_colors(image: Pixels) -> Int32[np.ndarray, "h w 3"]:
    """CIELAB in steps of 1 / LAB_STEPS."""
    from skimage.color import rgb2lab

    return np.asarray(np.rint(rgb2lab(image) * LAB_STEPS), np.int32)


def small_regions(lab: Int32[np.ndarray, "h w 3"], scale: float, least: int) -> MaskIds:
    """As Felzenszwalb and Huttenlocher have it; what costs the same is taken in the order of `_neighbours`."""
    costs, ends = _neighbours(lab)
    order = np.argsort(costs, kind="stable")
    edges = list(zip(costs[order].tolist(), *ends[order].T.tolist(), strict=True))
    forest = _Forest(lab.shape[0] * lab.shape[1], scale)
    for cost, a, b in edges:
        a, b = forest.root(a), forest.root(b)
        if cost < min(forest.limit(a), forest.limit(b)):
            forest.merge(a, b, cost)
    for cost, a, b in edges:
        a, b = forest.root(a), forest.root(b)
        if min(forest.sizes[a], forest.sizes[b]) < least:
            forest.merge(a, b, cost)
    roots = [forest.root(pixel) for pixel in range(len(forest.sizes))]
    return np.unique(roots, return_inverse=True)[1].reshape(lab.shape[:2]).astype(np.int32)


def flooded(heights: MaskIds, markers: MaskIds) -> MaskIds:
    """The twin of `kernels.photo_regions.flooded`: the lowest reached pixel goes on, of equal ones the oldest."""
    owner = markers.copy()
    reached = [(heights[at], turn, at) for turn, at in enumerate(zip(*np.nonzero(markers), strict=True))]
    turn = len(reached)
    while reached:
        reached.remove(lowest := min(reached))
        y, x = lowest[2]
        for at in ((y - 1, x), (y, x - 1), (y, x + 1), (y + 1, x)):
            if 0 <= at[0] < owner.shape[0] and 0 <= at[1] < owner.shape[1] and not owner[at]:
                owner[at] = owner[y, x]
                reached.append((heights[at], turn, at))
                turn += 1
    return owner


def _neighbours(lab: Int32[np.ndarray, "h w 3"]) -> tuple[Float64[np.ndarray, " e"], Int64[np.ndarray, "e 2"]]:
    """How far apart blurred neighbours are, and their numbers: to the right, below, below on the right and left."""
    from scipy.ndimage import gaussian_filter

    colors = gaussian_filter(lab / LAB_STEPS, (SIGMA, SIGMA, 0))
    numbers = np.arange(lab.shape[0] * lab.shape[1]).reshape(lab.shape[:2])
    all_of, left, right = slice(None), slice(None, -1), slice(1, None)
    sides = [
        ((all_of, left), (all_of, right)), ((left, all_of), (right, all_of)),
        ((left, left), (right, right)), ((left, right), (right, left)),
    ]  # fmt: skip
    costs = [np.sqrt(((colors[b] - colors[a]) ** 2).sum(-1)).ravel() for a, b in sides]
    ends = [np.stack([numbers[a].ravel(), numbers[b].ravel()], 1) for a, b in sides]
    return np.concatenate(costs), np.concatenate(ends)


class _Forest:
    """Pixels in trees, whose roots are their first pixels."""

    def __init__(self, pixels: int, scale: float) -> None:
        self.parents, self.sizes, self.inner = list(range(pixels)), [1] * pixels, [0.0] * pixels
        self.scale = scale

    def root(self, pixel: int) -> int:
        while self.parents[pixel] != pixel:
            pixel = self.parents[pixel]
        return pixel

    def limit(self, root: int) -> float:
        return self.inner[root] + self.scale / self.sizes[root]

    def merge(self, a: int, b: int, cost: float) -> None:
        if a != b:
            first, other = sorted((a, b))
            self.parents[other] = first
            self.sizes[first] += self.sizes[other]
            self.inner[first] = cost


def region_graph(labels: MaskIds, lab: Int32[np.ndarray, "h w 3"], sight: Sight) -> RegionGraph:
    """Return the sums over regions and over the borders between them."""
    count = int(labels.max()) + 1
    pairs, borders = _borders(labels, lab, sight)
    sums = np.zeros((count, COLUMNS))
    flat, colors = labels.ravel().astype(np.int64), lab.reshape(-1, 3)
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
    return slice(HISTOGRAM.start + channel * BINS_PER_CHANNEL, HISTOGRAM.start + (channel + 1) * BINS_PER_CHANNEL)


def _histograms(
    flat: Int64[np.ndarray, " p"], values: Float64[np.ndarray, " p"], channel: int, count: int
) -> Int64[np.ndarray, "n b"]:
    low, high = _RANGES[channel]
    places = (values / LAB_STEPS - low) * (BINS_PER_CHANNEL / (high - low))
    bins = np.clip(places.astype(np.int64), 0, BINS_PER_CHANNEL - 1)
    return np.bincount(flat * BINS_PER_CHANNEL + bins, minlength=count * BINS_PER_CHANNEL).reshape(
        count, BINS_PER_CHANNEL
    )


def _texture(lightness: MaskIds) -> Float64[np.ndarray, "h w"]:
    """How unlike its left and upper neighbours a pixel is, in steps of CIELAB."""
    texture = np.zeros(lightness.shape)
    texture[:, 1:] += np.abs(np.diff(lightness, axis=1))
    texture[1:] += np.abs(np.diff(lightness, axis=0))
    return texture


def _boxes(labels: MaskIds, count: int) -> Float64[np.ndarray, "n 4"]:
    from scipy.ndimage import find_objects

    boxes = np.zeros((count, 4))
    for i, (rows, columns) in enumerate(find_objects(labels + 1)):
        boxes[i] = columns.start, rows.start, -columns.stop, -rows.stop
    return boxes


def _borders(
    labels: MaskIds, lab: Int32[np.ndarray, "h w 3"], sight: Sight
) -> tuple[Int32[np.ndarray, "e 2"], Float64[np.ndarray, "e 5"]]:
    """Touching regions and the sums over their border: see RegionGraph."""
    turned = Sight(sight.borders.T, sight.traits.transpose(1, 0, 2))
    across, down = _sides(labels, lab, sight), _sides(labels.T, lab.transpose(1, 0, 2), turned)
    ends = np.concatenate([across[0], down[0]])
    steps = np.concatenate([across[1], down[1]])
    count = int(labels.max()) + 1
    keys, owner = np.unique(ends.min(1).astype(np.int64) * count + ends.max(1), return_inverse=True)
    sums = [np.bincount(owner, column, len(keys)).astype(float) for column in steps.T]  # of nothing: whole
    return np.stack([keys // count, keys % count], 1).astype(np.int32), np.stack(sums, 1)


def _sides(
    labels: MaskIds, lab: Int32[np.ndarray, "h w 3"], sight: Sight
) -> tuple[Int32[np.ndarray, "s 2"], Float64[np.ndarray, "s 5"]]:
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
