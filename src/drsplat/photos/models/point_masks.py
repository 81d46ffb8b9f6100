"""Masks of everything in an image, from a model that answers points.

Source: the automatic mask generator of segment-anything, in the form of LangSplat's fork, which keeps
the three masks that a point has (part, object, group) apart as levels.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import product
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from scipy import ndimage

from ...base.arrays import Bool, ByteValues, Indices, Mask, Numbers, Pixels, PlanePoints
from ...errors import InputError
from ...scene.masks.masks import LEVELS, Masks, tight_box
from ...scene.masks.selection import mask_nms

_MIDDLE, _LARGE = 1, 2
_OUTPUTS = {"default": (0, 1, 2), "small": (0,), "medium": (1,), "large": (2,)}
Box = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels, ends excluded."""
Found = TypeVar("Found", "_Candidate", "_Cleaned")
_CROP_EDGE_PIXELS = 20  # Source: segment-anything utils/amg.py, is_box_near_crop_edge


@dataclass(frozen=True)
class PointMaskSettings:
    """Numbers of the paper: those of LangSplat's preprocess.py, otherwise segment-anything's defaults.

    Raises: InputError: a number out of its range, an unknown level.
    """

    points_per_side: int = 32  # LangSplat
    first_points_per_side: int | None = None  # a coarser grid to begin with; None: the whole grid, as LangSplat has it
    most_points: int | None = None  # of a crop, all rounds together; where there are more, evenly spread ones
    min_predicted_iou: float = 0.7  # LangSplat; kept if above
    min_stability: float = 0.85  # LangSplat; kept if not below
    stability_offset: float = 1.0  # segment-anything; logits above and below the mask's edge
    max_box_iou: float = 0.7  # LangSplat; box NMS within a crop, by predicted IoU
    crop_layers: int = 1  # LangSplat; layer n has 4**n crops
    crop_points_divisor: int = 1  # LangSplat; layer n has points_per_side // divisor**n
    crop_overlap: float = 512 / 1500  # segment-anything; of the shorter side of the image
    max_crop_box_iou: float = 0.7  # segment-anything; box NMS between crops, smaller crops first
    min_region: int = 100  # LangSplat; pixels, see without_small_regions
    mask_iou: float = 0.8  # LangSplat; mask NMS
    mask_score: float = 0.7  # LangSplat; mask NMS
    mask_inner: float = 0.5  # LangSplat; mask NMS; 0 keeps what lies in a larger mask, and paints larger ones first
    levels: tuple[str, ...] = LEVELS  # LangSplat; Dr. Splat and OpenGaussian use large alone
    points_per_batch: int = 64  # segment-anything; of memory only

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if "points" in name and value is not None and value < 1:
                raise InputError(f"{name}: expected at least 1, got {value}")
        if not 0 <= self.crop_layers <= 4 or self.min_region < 0:
            raise InputError("crop_layers: expected 0 to 4, and min_region: 0 or more")
        if not 0 <= self.crop_overlap < 1:
            raise InputError(f"crop_overlap: expected 0 to below 1, got {self.crop_overlap}")
        if not self.levels or not set(self.levels) <= set(LEVELS):
            raise InputError(f"levels: expected some of {', '.join(LEVELS)}, got {self.levels}")

    @property
    def outputs(self) -> tuple[int, ...]:
        """Indices of the three masks of a point that the levels need."""
        return tuple(sorted({output for level in self.levels for output in _OUTPUTS[level]}))

    @property
    def looked_at(self) -> tuple[int, ...]:
        """Indices of masks to look at: in rounds also the middle one, which tells an object from its group."""
        in_rounds = self.first_points_per_side is not None
        return (_MIDDLE, _LARGE) if in_rounds and self.outputs == (_LARGE,) else self.outputs

    def sides(self, layer: int) -> Iterator[int]:
        """Yield the points per side of each round on a crop of this layer; each round doubles it."""
        last = max(1, self.points_per_side // self.crop_points_divisor**layer)
        side = last if self.first_points_per_side is None else self.first_points_per_side
        while side < last:
            yield side
            side *= 2
        yield last


class PointMasks(NamedTuple):
    """Masks of a batch of points, at the size of their crop.

    output: index of each mask among the three of its point. stability: area at a stricter threshold over area at a
    laxer one. point: number of its point in the call.
    """

    masks: Bool[np.ndarray, "n h w"]
    predicted_iou: Numbers
    stability: Numbers
    output: Indices
    point: Indices


@runtime_checkable
class PointPredictor(Protocol):
    """Model that has a mask or three for a point."""

    identity: Mapping[str, object]

    def find(self, crop: Pixels, points: PlanePoints, settings: PointMaskSettings) -> Iterator[PointMasks]:
        """Yield masks at points (x, y in pixels of the crop), by point, then by output, a few at a time.

        Masks of outputs outside settings.looked_at, with a predicted IoU not above min_predicted_iou or a stability
        below min_stability, may be left out: they are dropped anyway.
        """
        ...


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Mask that passed the thresholds.

    bits: its box's pixels, eight to a byte. sharpness: one over the pixels of its crop.
    """

    box: Box
    bits: ByteValues
    predicted_iou: float
    stability: float
    output: int
    sharpness: float

    @property
    def part(self) -> Mask:
        height, width = self.box[3] - self.box[1], self.box[2] - self.box[0]
        return np.unpackbits(self.bits, count=height * width).reshape(height, width).astype(bool)


class _Cleaned(NamedTuple):
    """Mask without small regions. unchanged: 1 where it had none, else 0. score: predicted IoU times stability."""

    box: Box
    part: Mask
    unchanged: float
    score: float


class PointSegmenter:
    """Segmenter that prompts a model with a grid of points and keeps the good, distinct masks.

    Memory: the bits of the masks of one crop that pass the thresholds, and what the predictor needs.
    """

    def __init__(self, predictor: PointPredictor, settings: PointMaskSettings | None = None):
        self.predictor, self.settings = predictor, settings or PointMaskSettings()
        self.identity: Mapping[str, object] = {**predictor.identity, "settings": asdict(self.settings)}

    def segment(self, image: Pixels) -> dict[str, Masks]:
        """Return masks by level, in painting order. Raises: InputError: an image without pixels."""
        height, width = image.shape[:2]
        if 0 in (height, width):
            raise InputError(f"an image of {width}x{height} pixels: expected at least 1x1")
        s = self.settings
        by_level: dict[str, list[_Candidate]] = {level: [] for level in s.levels}
        for layer, crop in crop_boxes(height, width, s.crop_layers, s.crop_overlap):
            passing = self._in_crop(image, crop, layer)
            for level, candidates in by_level.items():
                of_level = [candidate for candidate in passing if candidate.output in _OUTPUTS[level]]
                candidates += _distinct(of_level, "predicted_iou", s.max_box_iou)

        @cache  # levels share candidates
        def cleaned(candidate: _Candidate) -> _Cleaned:
            box, part, changed = without_small_regions(candidate.box, candidate.part, (height, width), s.min_region)
            return _Cleaned(box, part, float(not changed), candidate.predicted_iou * candidate.stability)

        return {level: self._level(found, (height, width), cleaned) for level, found in by_level.items()}

    def _in_crop(self, image: Pixels, crop: Box, layer: int) -> list[_Candidate]:
        """Return the passing masks of a crop, from rounds of finer grids where no mask explains the pixels yet.

        A pixel is explained by a mask of the finest output wanted. For the large output only the part that the point's
        good middle mask also has is explained: the rest of a group gets points of its own.
        """
        s, left = self.settings, self.settings.most_points
        x0, y0, x1, y1 = crop
        pixels = np.ascontiguousarray(image[y0:y1, x0:x1])
        explained = np.zeros(pixels.shape[:2], np.bool_)
        passing: list[_Candidate] = []
        for side in s.sides(layer):
            points = open_points(side, explained)
            if left is not None:
                if len(points) > left:
                    points = points[np.linspace(0, len(points) - 1, left).astype(np.int64)]
                left -= len(points)
            middle: dict[int, Mask] = {}  # the last good middle mask, by its point, maybe of the batch before
            for batch in self.predictor.find(pixels, points, s) if len(points) else ():
                good = (batch.predicted_iou > s.min_predicted_iou) & (batch.stability >= s.min_stability)
                for i in np.flatnonzero(good):
                    mask, output, point = batch.masks[i], int(batch.output[i]), int(batch.point[i])
                    if output in s.outputs:
                        score = float(batch.predicted_iou[i]), float(batch.stability[i])
                        passing += _passing(mask, score, output, crop, image.shape[:2])
                    if output == s.outputs[0]:
                        explained |= mask & middle.pop(point, True)
                    elif (output, s.outputs[0]) == (_MIDDLE, _LARGE):
                        middle = {point: mask}
        return passing

    def _level(
        self, candidates: list[_Candidate], size: tuple[int, int], cleaned: Callable[[_Candidate], _Cleaned]
    ) -> Masks:
        s = self.settings
        if s.crop_layers:
            candidates = _distinct(candidates, "sharpness", s.max_crop_box_iou)
        found = [cleaned(candidate) for candidate in candidates]
        if s.min_region:
            found = _distinct(found, "unchanged", max(s.max_box_iou, s.max_crop_box_iou))
        boxes = np.array([each.box for each in found], np.int32).reshape(-1, 4)
        scores = np.array([each.score for each in found], np.float32)
        masks = Masks(*size, boxes, tuple(each.part for each in found), scores)
        stay = mask_nms(masks, s.mask_iou, s.mask_score, s.mask_inner)
        if not s.mask_inner:
            stay = stay[np.argsort([-masks.parts[i].sum() for i in stay], kind="stable")]
        return masks.subset(stay)


def _passing(
    mask: Mask, score: tuple[float, float], output: int, crop: Box, size: tuple[int, ...]
) -> Iterator[_Candidate]:
    """Yield the candidate of a mask of a crop, unless it is empty or cut by the crop."""
    left, top, right, bottom = crop
    x0, y0, x1, y1 = tight_box(mask) or (0, 0, 0, 0)
    box = (x0 + left, y0 + top, x1 + left, y1 + top)
    if x1 and not cut_by_crop(box, crop, size):
        yield _Candidate(box, np.packbits(mask[y0:y1, x0:x1]), *score, output, 1 / ((right - left) * (bottom - top)))


def _distinct(found: list[Found], score: str, max_iou: float) -> list[Found]:
    """Return what `box_nms` keeps by the scores of this name."""
    chosen = box_nms([each.box for each in found], [getattr(each, score) for each in found], max_iou)
    return [found[i] for i in chosen]


def point_grid(side: int) -> PlanePoints:
    """Return side x side points (x, y) in the middles of equal cells of the unit square, row by row."""
    middles = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(middles, middles), -1).reshape(-1, 2)


def open_points(side: int, explained: Mask) -> PlanePoints:
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
    return points[is_open]


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


def cut_by_crop(box: Box, crop: Box, size: tuple[int, ...]) -> bool:
    """Return whether a mask comes within 20 px of an edge of its crop that is not an edge of the image.

    Such a mask may continue outside; the whole image or a neighbouring crop has it in full.
    """
    corners = np.subtract(box, (0, 0, 1, 1))  # pixels, both included, as in the source
    near_crop = np.abs(corners - crop) <= _CROP_EDGE_PIXELS
    near_image = np.abs(corners - (0, 0, size[1], size[0])) <= _CROP_EDGE_PIXELS
    return bool((near_crop & ~near_image).any())


def box_nms(boxes: Sequence[Box], scores: Sequence[float], max_iou: float) -> Indices:
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
    box: Box, part: Mask, size: tuple[int, int], min_region: int
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
    if (islands == canvas).all():
        labels, _ = ndimage.label(canvas, np.ones((3, 3), int))
        islands &= labels != np.bincount(labels[canvas]).argmax()
    canvas &= ~islands
    left, top, right, bottom = tight_box(canvas) or (0, 0, 1, 1)
    shifted = (left + x0, top + y0, right + x0, bottom + y0)
    return shifted, canvas[top:bottom, left:right].copy(), True


def _regions_below(mask: Mask, limit: int) -> Mask:
    """Return the pixels of a mask whose connected region has fewer pixels than the limit."""
    labels, _ = ndimage.label(mask, np.ones((3, 3), int))
    small = np.bincount(labels.ravel()) < limit
    small[0] = False
    return small[labels]
