"""LERF-OVS labels: JSON with a polygon per object, filled as OpenCV's `fillPoly` fills them.

    LABEL_FOLDER/frame_00041.json
    {"info": {"name", "width", "height"}, "objects": [{"category", "bbox", "segmentation"}, ...]}

Polygons are in pixels, (x, y); (0, 0) is the centre of the top left one. Numbers lose their fraction.
Source: Kerr et al. 2023 (LERF); the annotations of Qin et al. 2024 (LangSplat).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Array, Float64, Int64, Mask
from ..errors import FormatError, InputError
from .json_files import as_fields, as_object, as_text, as_vector, excerpt, read_json
from .lvis import fill_polygon as fill_inside
from .photo_files import safe_name

MAX_SIDE_PIXELS = 16384
MAX_CORNERS = 1 << 16
Polygon = Int64[np.ndarray, "_ 2"]
Box = Float64[np.ndarray, "4"]


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """The labels that people drew on one photo.

    name: the photo's, without suffix. polygons, boxes: by category, one or more of each; boxes are (x1, y1, x2, y2),
    the least and the greatest corner, whichever corners they were drawn from.
    """

    name: str
    width: int
    height: int
    polygons: Mapping[str, Sequence[Polygon]]
    boxes: Mapping[str, Sequence[Box]]

    @cached_property
    def categories(self) -> tuple[str, ...]:
        return tuple(sorted(self.polygons))

    def mask(self, category: str) -> Mask:
        """Return all objects of the category in one."""
        united = np.zeros((self.height, self.width), bool)
        for polygon in self.polygons[category]:
            united |= fill_polygon(polygon, self.width, self.height)
        return united


class _Info(NamedTuple):
    width: int
    height: int
    name: str | None = None


def read_lerf_labels(folder: Path) -> list[LabelledFrame]:
    """Read the labelled frames of a scene, by name.

    Raises: InputError: no such folder, or no label in it. FormatError: as `read_lerf_frame`.
    """
    paths = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not paths:
        raise InputError(f"{folder}: expected a folder of LERF-OVS labels, frame_XXXXX.json")
    return [read_lerf_frame(path) for path in paths]


def read_lerf_frame(path: Path) -> LabelledFrame:
    """Return one file of labels.

    Raises: InputError: there is no such file. FormatError: damaged; the message names file, object and field.
    """
    document = as_fields(read_json(path), str(path), info=_Info, objects=list[object])
    info = document["info"]
    size = (_side(info.width, f"{path}: info.width"), _side(info.height, f"{path}: info.height"))
    if info.name is not None and Path(safe_name(info.name, f"{path}: info.name")).stem != path.stem:
        raise FormatError(f"{path}: info.name: expected '{path.stem}', got {excerpt(info.name)}")
    polygons: dict[str, list[Polygon]] = {}
    boxes: dict[str, list[Box]] = {}
    for index, entry in enumerate(document["objects"]):
        category, polygon, box = _object(entry, size, f"{path}: object {index}")
        polygons.setdefault(category, []).append(polygon)
        boxes.setdefault(category, []).append(box)
    return LabelledFrame(path.stem, *size, polygons, boxes)


def fill_polygon(polygon: Polygon, width: int, height: int) -> Mask:
    """Return the pixels inside (even-odd) or on the edge of a polygon of whole corners.

    The same pixels as OpenCV 5.0's `fillPoly` for corners within the frame; 4.10 draws edges a little
    otherwise (0.02 % of the pixels of large polygons), and both cut edges that leave the frame.

    Source: OpenCV `fillPoly` with 8-connected edges.
    """
    filled = fill_inside(polygon + 0.5, height, width)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        x, y = _line(start, end)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        filled[y[inside], x[inside]] = True
    return filled


def _line(start: Array, end: Array) -> tuple[Array, Array]:
    """Return Bresenham's pixels from left to right."""
    if end[0] < start[0]:
        start, end = end, start
    dx, dy = (int(v) for v in end - start)
    steps = max(dx, abs(dy))
    minor = min(dx, abs(dy))
    along = np.arange(steps + 1)
    across = -((steps - 2 * along * minor) // (2 * steps)) if steps else along
    x, y = (along, across) if dx >= abs(dy) else (across, along)
    return start[0] + x, start[1] + (y if dy >= 0 else -y)


def _side(side: int, where: str) -> int:
    if not 1 <= side <= MAX_SIDE_PIXELS:
        raise FormatError(f"{where}: expected 1 to {MAX_SIDE_PIXELS} pixels, got {side}")
    return side


def _object(entry: object, size: tuple[int, int], where: str) -> tuple[str, Polygon, Box]:
    entry = as_object(entry, where)
    category = as_text(entry.get("category"), f"{where}: category")
    if not category.strip() or not category.isprintable():
        raise FormatError(f"{where}: category: expected a text, got {excerpt(category)}")
    where = f"{where} ({category[:60]!a})"
    polygon = _polygon(entry.get("segmentation"), size, f"{where}: segmentation")
    if "bbox" not in entry:
        return category, polygon, np.concatenate([polygon.min(0), polygon.max(0)]).astype(float)
    corners = as_vector(entry["bbox"], 4, f"{where}: bbox").reshape(2, 2)
    return category, polygon, np.concatenate([corners.min(0), corners.max(0)])


def _polygon(value: object, size: tuple[int, int], where: str) -> Polygon:
    if not isinstance(value, list) or not 3 <= len(value) <= MAX_CORNERS:
        raise FormatError(f"{where}: expected three or more corners [x, y], got {excerpt(value)}")
    corners = np.stack([as_vector(corner, 2, where) for corner in value])
    if (corners < -np.array(size)).any() or (corners > 2 * np.array(size)).any():
        raise FormatError(f"{where}: corners far outside of the {size[0]}x{size[1]} frame")
    return corners.astype(np.int64)
