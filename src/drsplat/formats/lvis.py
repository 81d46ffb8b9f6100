"""Instances of LVIS and COCO: photos in which people have outlined things.

A mask is polygons or run lengths. A run-length mask goes down the columns of the image, one column after the other:
so many pixels outside, so many inside, and so on in turns.

Source: the LVIS v1 and COCO data formats (lvisdataset.org/dataset, cocodataset.org/#format-data); the COCO API
(masks.h, maskApi.c), its data formats; read for facts.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import numpy as np

from ..base.arrays import Array, Bool, Float, Float64, Indices, Mask
from ..base.contents import file_text
from ..errors import DrSplatError, FormatError
from .json_files import as_count, as_number, as_object, as_text, excerpt
from .photo_files import safe_name

_FIRST_CODE = 48
_DIGIT_MASK = 0x1F
_CONTINUATION_BIT = 0x20
_SIGN_BIT = 0x10
_DIGIT_BITS = 5
_MAX_DIGITS = 8  # 40 bits: more pixels than any photo has
_BLOCK_CROSSINGS = 1 << 18  # that are worked on at once, so that memory does not grow with a polygon's height


T = TypeVar("T")
MAX_SIDE_PIXELS = 1 << 16
_MAX_COORDINATE = 1 << 20


@dataclass(frozen=True)
class AnnotatedPhoto:
    """name: relative to the folder of the photos. height, width: pixels, as annotated."""

    id: int
    name: str
    height: int
    width: int


@dataclass(frozen=True)
class Runs:
    """Run lengths of a mask: numbers, or COCO's compressed text of them."""

    counts: Indices | str
    height: int
    width: int


Polygons = tuple[Float64[np.ndarray, " _"], ...]
"""Outlines that are taken together, each x0, y0, x1, y1, ... in pixels."""


@dataclass(frozen=True, slots=True)
class Instance:
    """One outlined thing. area: as the file says, pixels. crowd: many things under one outline."""

    id: int
    photo: int
    category: int
    area: float
    crowd: bool
    segmentation: Polygons | Runs


@dataclass(frozen=True)
class Annotations:
    """Content of one file; instances in its order. photos, categories: by id."""

    path: Path
    photos: Mapping[int, AnnotatedPhoto]
    categories: Mapping[int, str]
    instances: tuple[Instance, ...]

    def mask(self, instance: Instance) -> Mask:
        """Return the pixels of an instance; polygons are filled by `lvis.fill_polygon` and united.

        Raises: FormatError: runs that do not fit the photo.
        """
        photo, where = self.photos[instance.photo], f"{self.path}, annotation {instance.id}"
        height, width, segmentation = photo.height, photo.width, instance.segmentation
        if isinstance(segmentation, Runs):
            where += ": segmentation"
            counts = segmentation.counts
            runs = unpack_counts(counts, where) if isinstance(counts, str) else counts
            return decode_runs(runs, height, width, where)
        mask = np.zeros((height, width), bool)
        for polygon in segmentation:
            mask |= fill_polygon(polygon.reshape(-1, 2), height, width)
        return mask


def read_annotations(path: str | Path) -> Annotations:
    """Read the annotations in a JSON file of LVIS v1 or COCO.

    A photo's name is its file_name; LVIS v1 has none, then it is the end of its coco_url with the
    folder of the split ("train2017/000000391895.jpg"), because LVIS's splits are not COCO's.
    Outlines of fewer than three corners are taken as they are: they hold no pixel.

    Raises: InputError: there is no such file. FormatError: the file is no such JSON; the error names
    the entry and the field.
    """
    path = Path(path)
    document = _document(path)
    photos = _by_id(document["images"], f"{path}, image", _photo)
    categories = _by_id(
        document["categories"],
        f"{path}, category",
        lambda entry, _, where: as_text(entry.get("name"), f"{where}: name"),
    )
    instances = _by_id(document["annotations"], f"{path}, annotation", _instance)
    for instance in instances.values():
        where = f"{path}, annotation {instance.id}"
        photo = photos.get(instance.photo)
        if photo is None:
            raise FormatError(f"{where}: image_id: there is no image {instance.photo}")
        if instance.category not in categories:
            raise FormatError(f"{where}: category_id: there is no category {instance.category}")
        runs = instance.segmentation
        if isinstance(runs, Runs) and (runs.height, runs.width) != (photo.height, photo.width):
            raise FormatError(
                f"{where}: segmentation: size: {runs.width}x{runs.height}, but its image has "
                f"{photo.width}x{photo.height}"
            )
    return Annotations(path, photos, categories, tuple(instances.values()))


def _document(path: Path) -> dict[str, list[object]]:
    """Read LVIS's training set: outlines become arrays while its 1.1 GB of text are parsed."""
    try:
        document = json.loads(file_text(path), object_hook=_compacted)
    except DrSplatError:
        raise
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: expected JSON: {error}") from error
    if not isinstance(document, dict) or not all(
        isinstance(document.get(key), list) for key in ("images", "annotations", "categories")
    ):
        raise FormatError(
            f"{path}: expected an object with the lists images, annotations and categories, as LVIS "
            f"and COCO have, got {excerpt(document)}"
        )
    return document


def _compacted(entry: dict[str, object]) -> dict[str, object]:
    """Turn lists of numbers into arrays; anything else is left for the checks to name."""
    outlines = entry.get("segmentation")
    if isinstance(outlines, list):
        entry["segmentation"] = [_array(outline, np.float64) for outline in outlines]
    if "counts" in entry:
        entry["counts"] = _array(entry["counts"], np.int64)
    return entry


def _array(values: object, dtype: type[np.float64] | type[np.int64]) -> object:
    kinds: set[type] = {int} if dtype is np.int64 else {int, float}
    if not isinstance(values, list) or not set(map(type, values)) <= kinds:
        return values
    try:
        return np.array(values, dtype)
    except OverflowError:
        return values


def _by_id(entries: list[object], what: str, parse: Callable[[dict[str, object], int, str], T]) -> dict[int, T]:
    found: dict[int, T] = {}
    for place, entry in enumerate(entries):
        entry = as_object(entry, f"{what} at place {place}")
        number = as_count(entry.get("id"), f"{what} at place {place}: id")
        if number in found:
            raise FormatError(f"{what} {number}: the id occurs twice")
        found[number] = parse(entry, number, f"{what} {number}")
    return found


def _photo(entry: dict[str, object], number: int, where: str) -> AnnotatedPhoto:
    height, width = (as_count(entry.get(key), f"{where}: {key}") for key in ("height", "width"))
    if not (1 <= height <= MAX_SIDE_PIXELS and 1 <= width <= MAX_SIDE_PIXELS):
        raise FormatError(f"{where}: height, width: no photo has {width}x{height} pixels")
    return AnnotatedPhoto(number, _photo_name(entry, where), height, width)


def _photo_name(entry: dict[str, object], where: str) -> str:
    name = entry.get("file_name")
    if isinstance(name, str):
        return safe_name(name, f"{where}: file_name")
    url = entry.get("coco_url")
    if not isinstance(url, str):
        raise FormatError(f"{where}: expected a text file_name, or coco_url as LVIS has")
    try:
        place = urlsplit(url).path
    except ValueError as error:
        raise FormatError(f"{where}: coco_url: {error}") from None
    return safe_name("/".join(place.strip("/").split("/")[-2:]), f"{where}: coco_url")


def _instance(entry: dict[str, object], number: int, where: str) -> Instance:
    photo, category = (as_count(entry.get(key), f"{where}: {key}") for key in ("image_id", "category_id"))
    area = as_number(entry.get("area"), f"{where}: area")
    crowd = as_count(entry.get("iscrowd", 0), f"{where}: iscrowd") != 0
    segmentation = _segmentation(entry.get("segmentation"), f"{where}: segmentation")
    return Instance(number, photo, category, area, crowd, segmentation)


def _segmentation(value: object, where: str) -> Polygons | Runs:
    if isinstance(value, dict):
        counts, size = value.get("counts"), value.get("size")
        if not isinstance(size, list) or len(size) != 2:
            raise FormatError(f"{where}: size: expected [height, width], got {excerpt(size)}")
        height, width = (as_count(side, f"{where}: size") for side in size)
        if not isinstance(counts, str | np.ndarray):
            raise FormatError(f"{where}: counts: expected whole numbers or compressed text, got {excerpt(counts)}")
        return Runs(counts, height, width)
    if not isinstance(value, list):
        raise FormatError(f"{where}: expected polygons or run lengths, got {excerpt(value)}")
    for polygon in value:
        if not isinstance(polygon, np.ndarray) or len(polygon) % 2:
            raise FormatError(f"{where}: expected polygons, lists of x and y in turns; got {excerpt(polygon)}")
        if not (np.abs(polygon) <= _MAX_COORDINATE).all():  # false for NaN
            raise FormatError(f"{where}: a polygon has a coordinate that no photo has")
    return tuple(value)


def decode_runs(counts: Indices, height: int, width: int, where: str) -> Mask:
    """Return the mask of run lengths, the first of which are pixels outside.

    Raises: FormatError: a negative length, or lengths that do not add up to the image. Nothing is
    allocated before that is known.
    """
    pixels = height * width
    wrong = counts[(counts < 0) | (counts > pixels)]
    if len(wrong):
        raise FormatError(f"{where}: a run of {wrong[0]} pixels in an image of {width}x{height}, {pixels} pixels")
    total = sum(counts.tolist())  # Python's integers: a sum of int64 could wrap to the right number
    if total != pixels:
        raise FormatError(f"{where}: the runs add up to {total} pixels, the image {width}x{height} has {pixels}")
    inside = np.arange(len(counts)) % 2 == 1
    return np.ascontiguousarray(np.repeat(inside, counts).reshape(width, height).T)


def unpack_counts(text: str, where: str) -> Indices:
    """Run lengths from COCO's compressed text.

    A number is a row of characters, each 48 plus five bits, lowest first; 32 says that more follow, and the fifth bit
    of the last is the sign. From the fourth on, a number is the difference from the length two before.

    Raises: FormatError: other characters, a number that does not end or is too long.
    """
    raw = np.frombuffer(text.encode("utf-8", "replace"), np.uint8)
    codes: Array = raw - np.uint8(_FIRST_CODE)  # below 48 wraps to above 63
    bad = np.flatnonzero(codes > _DIGIT_MASK + _CONTINUATION_BIT)
    if len(bad):
        raise FormatError(
            f"{where}: expected compressed run lengths, characters '0' to 'o'; got byte {raw[bad[0]]} at {bad[0]}"
        )
    if len(codes) == 0:
        return np.zeros(0, np.int64)
    last = (codes & _CONTINUATION_BIT) == 0
    ends = np.flatnonzero(last)
    lengths = np.diff(ends, prepend=-1)
    if not last[-1] or lengths.max() > _MAX_DIGITS:
        raise FormatError(f"{where}: expected compressed run lengths, got a number without end")
    place = np.arange(len(codes)) - np.repeat(ends - lengths + 1, lengths)
    digits = (codes & _DIGIT_MASK).astype(np.int64) << (_DIGIT_BITS * place)
    numbers = np.add.reduceat(digits, ends - lengths + 1)
    numbers -= np.where(codes[ends] & _SIGN_BIT, np.int64(1) << (_DIGIT_BITS * lengths), 0)
    numbers[1::2] = np.cumsum(numbers[1::2])
    numbers[2::2] = np.cumsum(numbers[2::2])
    return np.asarray(numbers)


def fill_polygon(points: Float[Array, "v 2"], height: int, width: int) -> Mask:
    """Return the pixels whose centres lie inside a closed polygon, by the even-odd rule.

    points: x, y in pixels; the centre of pixel (0, 0) is at (0.5, 0.5), a centre on a left or upper
    edge is inside. What lies outside the image is cut off. pycocotools rounds the outline to a grid of
    fifths of a pixel instead of testing centres: masks differ from its by pixels on the outline only.
    """
    mask = np.zeros((height, width), bool)
    ends = np.roll(points, -1, axis=0).astype(np.float64)
    begins = points.astype(np.float64)
    top = np.ceil(np.minimum(begins[:, 1], ends[:, 1]) - 0.5).clip(0, height).astype(np.int64)
    bottom = np.ceil(np.maximum(begins[:, 1], ends[:, 1]) - 0.5).clip(0, height).astype(np.int64)
    block = max(1, _BLOCK_CROSSINGS // max(len(points), width))
    for start in range(int(top.min(initial=height)), int(bottom.max(initial=0)), block):
        stop = min(start + block, height)
        spans = top.clip(start, stop), bottom.clip(start, stop)
        mask[start:stop] = _parity(begins, ends, *spans, slice(start, stop), width)
    return mask


def _parity(
    begins: Float[Array, "n 2"], ends: Float[Array, "n 2"], top: Indices, bottom: Indices, rows: slice, width: int
) -> Bool[Array, "r w"]:
    """Return the inside of some rows: pixels with an odd number of edges (each in rows top to bottom) to the left."""
    counts = bottom - top
    edge = np.repeat(np.arange(len(counts)), counts)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + top[edge]
    (x0, y0), (x1, y1) = begins[edge].T, ends[edge].T
    crossing = x0 + (row + 0.5 - y0) / (y1 - y0) * (x1 - x0)
    column = np.ceil(crossing - 0.5).clip(0, width).astype(np.int64)
    shape = (rows.stop - rows.start, width + 1)
    flips = np.bincount((row - rows.start) * shape[1] + column, minlength=shape[0] * shape[1])
    return np.cumsum(flips.reshape(shape), axis=1)[:, :width] % 2 == 1
