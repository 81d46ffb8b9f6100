"""Grids of points, crops of images, and the boxes and regions to keep."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy import ndimage

from ...base.arrays import Bool, Float64, Int64
from ...scene.masks.masks import tight_box

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels, ends excluded."""
_CROP_EDGE_PIXELS = 20  # Source: segment-anything utils/amg.py, is_box_near_crop_edge


def point_grid(side: int) -> Float64[np.ndarray, "p 2"]:
    """Return side x side points (x, y) in the middles of equal cells of the unit square, row by row."""
    middles = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(middles, middles), -1).reshape(-1, 2)


def open_points(side: int, explained: Bool[np.ndarray, "h w"]) -> Float64[np.ndarray, "p 2"]:
    """Return the grid points (x, y in pixels) outside `explained` whose cells are not more than half explained.

    Without any explained pixel that is the whole grid. Slivers between masks get no point.
    """
    height, width = explained.shape
    points = point_grid(side) * (width, height)
    column, row = np.minimum(points.astype(np.int64), (width - 1, height - 1)).T
    half_cell = np.array([width, height]) / (2 * side)
    x0, y0 = np.maximum(np.floor(points - half_cell), 0).astype(np.int64).T
    x1, y1 = np.minimum(np.ceil(points + half_cell), (width, height)).astype(np.int64).T
    sums = np.pad(explained.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    covered = sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]
    is_open = ~explained[row, column] & (2 * covered <= (x1 - x0) * (y1 - y0))
    return np.asarray(points[is_open])


def spread(points: Float64[np.ndarray, "p 2"], most: int | None) -> Float64[np.ndarray, "q 2"]:
    """Return all points, or `most` of them evenly spread over their order."""
    if most is None or len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def crop_boxes(height: int, width: int, layers: int, overlap: float) -> list[tuple[int, Box]]:
    """Return the whole image as layer 0, then 2**n x 2**n overlapping crops of each layer n, column by column.

    Crops without pixels, which images of a pixel's breadth have, are left out.
    Source: segment-anything utils/amg.py, generate_crop_boxes.
    """
    boxes: list[tuple[int, Box]] = [(0, (0, 0, width, height))]
    for layer in range(1, layers + 1):
        number = 2**layer
        shared = int(overlap * min(height, width) * (2 / number))
        across, down = (-(-(shared * (number - 1) + n) // number) for n in (width, height))
        for i, j in product(range(number), range(number)):
            x0, y0 = i * (across - shared), j * (down - shared)
            if x0 < width and y0 < height:
                box = (x0, y0, min(x0 + across, width), min(y0 + down, height))
                boxes.append((layer, box))
    return boxes


def cut_by_crop(box: Box, crop: Box, size: tuple[int, int]) -> bool:
    """Return whether a mask comes within 20 px of an edge of its crop that is not an edge of the image.

    Such a mask may continue outside; the whole image or a neighbouring crop has it in full.
    """
    corners = np.subtract(box, (0, 0, 1, 1))  # pixels, both included, as in the source
    near_crop = np.abs(corners - crop) <= _CROP_EDGE_PIXELS
    near_image = np.abs(corners - (0, 0, size[1], size[0])) <= _CROP_EDGE_PIXELS
    return bool((near_crop & ~near_image).any())


def box_nms(boxes: Sequence[Box], scores: Sequence[float], max_iou: float) -> Int64[np.ndarray, " k"]:
    """Return indices of boxes, best first, that overlap no kept box of a higher score by more than max_iou.

    Of equal scores the earlier goes first. Corners are pixels, both included, and the area is the
    product of their differences, as in the source; a box of one row has none and overlaps nothing.
    """
    corners = np.array(boxes, np.float64).reshape(-1, 4) - (0, 0, 1, 1)
    areas = (corners[:, 2] - corners[:, 0]) * (corners[:, 3] - corners[:, 1])
    alive, chosen = np.ones(len(corners), bool), []
    for i in np.argsort(-np.array(scores, np.float64), kind="stable"):
        if not alive[i]:
            continue
        chosen.append(i)
        low = np.maximum(corners[:, :2], corners[i, :2])
        high = np.minimum(corners[:, 2:], corners[i, 2:])
        shared = np.maximum(high - low, 0).prod(1)
        union = areas + areas[i] - shared
        iou = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
        alive &= iou <= max_iou
    return np.array(chosen, np.int64)


def without_small_regions(
    box: Box, part: Bool[np.ndarray, "h w"], size: tuple[int, int], min_region: int
) -> tuple[Box, Bool[np.ndarray, "_ _"], bool]:
    """Fill the holes of a mask below min_region pixels, then remove its islands below min_region pixels.

    The largest island stays whatever its size: this rule drops no mask. The last says whether there was anything small,
    be it that island alone. Regions touch at sides or corners; small background at the image's edge is a hole too.
    Source: segment-anything utils/amg.py, remove_small_regions.
    """
    if min_region == 0:
        return box, part, False
    # margin wide enough that background around the box counts as small only if it is
    x0, y0 = max(0, box[0] - min_region), max(0, box[1] - min_region)
    x1, y1 = min(size[1], box[2] + min_region), min(size[0], box[3] + min_region)
    canvas = np.zeros((y1 - y0, x1 - x0), bool)
    canvas[box[1] - y0 : box[3] - y0, box[0] - x0 : box[2] - x0] = part
    holes = _regions_below(~canvas, min_region)
    canvas |= holes
    islands = _regions_below(canvas, min_region)
    if not (holes.any() or islands.any()):
        return box, part, False
    if islands.sum() == canvas.sum():
        islands &= ~_largest(canvas)
    canvas &= ~islands
    left, top, right, bottom = tight_box(canvas) or (0, 0, 1, 1)
    shifted = (left + x0, top + y0, right + x0, bottom + y0)
    return shifted, canvas[top:bottom, left:right].copy(), True


def _regions_below(mask: Bool[np.ndarray, "h w"], limit: int) -> Bool[np.ndarray, "h w"]:
    """Return the pixels of a mask whose connected region has fewer pixels than the limit."""
    labels, _ = ndimage.label(mask, np.ones((3, 3), int))
    small = np.bincount(labels.ravel()) < limit
    small[0] = False
    below: Bool[np.ndarray, "h w"] = small[labels]
    return below


def _largest(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    labels, _ = ndimage.label(mask, np.ones((3, 3), int))
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    largest: Bool[np.ndarray, "h w"] = labels == sizes.argmax()
    return largest
