"""Photos below a folder, in natural order of their numbers."""

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image

from ...base.contents import open_file
from ...errors import DrSplatError, InputError, warn
from ...formats.mask_files import FOLDER_NAME as MASK_FOLDER
from ...formats.mask_files import NO_NAME, mask_folders, masks_of
from ...formats.photo_files import folded, listed, safe_name
from ...scene.photos import PHOTO_FORMATS, check_cost, photo_size
from ...scene.views import same_aspect

PHOTO_ENDS = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif"}
VIDEO_ENDS = {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi"}
MAX_PHOTOS = 50_000
MIN_NUMBERED_SHARE = 0.8  # of the photos, for all of them to count as numbered
MAX_NUMBER_STEP = 50  # between successive photos: frames of a film are often thinned out
_SMALL = re.compile(r"(^|[._-])(thumb(nail)?s?|tn|small|preview|low|lowres|resized|mini|\d+(x\d+|px))(?=[._-]|$)[._-]?")
_DERIVED = re.compile(r"[._-](mask|depth|normals?|seg(mentation)?)$|^(dynamic_mask|mask|depth|normal)[._-]")
_MAP_FOLDER = re.compile(r"depths?|depth_maps|normals?|seg(mentation)?s?|labels|confidence")
_LOOK_SIDE_PIXELS = 8
_MAX_LOOK_DIFFERENCE = 4.0  # grey levels between a picture and a copy of it, in the mean
_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class Source:
    """Photo of the input folder.

    name: relative to the folder, with forward slashes. num_bytes and changed_ns: including its mask's, if it has one.
    """

    name: str
    path: Path
    num_bytes: int
    changed_ns: int
    mask: Path | None = None


def find_photos(folder: Path) -> list[Source]:
    """Return the photos of a folder and its subfolders, without hidden ones, masks, and smaller copies of photos.

    Warns: DrSplatWarning: files that are taken for something else than photos, with their number.
    Raises: InputError: no folder, no photo in it, or more than `MAX_PHOTOS`.
    """
    if not folder.is_dir():
        missing = "" if folder.exists() else "there is no such file or folder; "
        ends = ", ".join(sorted(end[1:] for end in VIDEO_ENDS))
        raise InputError(f"{folder}: {missing}expected a folder of photos or a video ({ends})")
    names = _names_in(folder)
    if not names:
        kinds = ", ".join(sorted(end[1:] for end in PHOTO_ENDS))
        raise InputError(f"{folder}: there is no photo in it: expected files that end in {kinds}")
    aside = set(smaller_copies(folder, names))
    _say_aside(folder, "smaller copies of other photos", sorted(aside))
    names = [name for name in names if name not in aside]
    masks = masks_of(folder, names)
    beside = {mask.relative_to(folder).as_posix() for mask in masks if mask is not None and mask.is_relative_to(folder)}
    photos = {_stem(name) for name in names if name not in beside and not _is_map(name)}
    aside = {name for name in names if name in beside or (_is_map(name) and _DERIVED.sub("", _stem(name)) in photos)}
    _say_aside(folder, "masks and maps of other photos", sorted(aside))
    sources = []
    for name, mask in zip(names, masks, strict=True):
        if name not in aside:
            stats = [each.stat() for each in (folder / name, mask) if each is not None]
            sizes, times = zip(*((stat.st_size, stat.st_mtime_ns) for stat in stats), strict=True)
            sources.append(Source(name, folder / name, sum(sizes), max(times), mask))
    unused = [] if any(source.mask for source in sources) else mask_folders(folder)
    if unused:
        raise InputError(f"{unused[0]}: {NO_NAME}")
    return sorted(sources, key=lambda source: in_order(source.name))


def _names_in(folder: Path) -> list[str]:
    """Return the names of pictures below a folder, relative to it, but for hidden ones and folders of masks."""
    names: list[str] = []
    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith((".", "@", "__")) and not MASK_FOLDER.fullmatch(name.lower())
        )
        for file in sorted(files):
            path = Path(parent, file)
            if path.suffix.lower() in PHOTO_ENDS and not file.startswith(".") and path.is_file():
                names.append(safe_name(path.relative_to(folder).as_posix(), str(folder)))
        if len(names) > MAX_PHOTOS:
            raise InputError(f"{folder}: expected at most {MAX_PHOTOS:,} photos, found more: capture a part at a time")
    return names


def smaller_copies(folder: Path, names: Sequence[str]) -> list[str]:
    """Return which pictures are thumbnails or reduced copies of another one: by name, size and look."""
    alike: dict[str, list[str]] = {}
    for name in names:
        alike.setdefault(_SMALL.sub("", _stem(name)), []).append(name)
    copies = []
    for group in (group for group in alike.values() if len(group) > 1):
        sizes = {}
        for name in group:
            with suppress(DrSplatError):  # which is said of it when it is brought
                sizes[name] = photo_size(folder / name)
        largest = max(sizes, key=lambda name: sizes[name], default="")
        smaller = [
            name
            for name in sizes
            if 2 * sizes[name][0] <= sizes[largest][0] and same_aspect(sizes[name], sizes[largest])
        ]
        copies += [name for name in smaller if _look_alike(folder / name, folder / largest)]
    return copies


def _stem(name: str) -> str:
    return folded(name.rpartition("/")[2].rpartition(".")[0])


def _is_map(name: str) -> bool:
    """Return whether a picture is named as one of depth, normals or labels."""
    return bool(_DERIVED.search(_stem(name)) or any(map(_MAP_FOLDER.fullmatch, name.lower().split("/")[:-1])))


def _look_alike(path: Path, other: Path) -> bool:
    looks = []
    for each in (path, other):
        try:
            with open_file(each) as file, Image.open(file, formats=PHOTO_FORMATS) as coded:
                check_cost(coded, file)
                coded.draft("RGB", (8 * _LOOK_SIDE_PIXELS, 8 * _LOOK_SIDE_PIXELS))
                small = coded.convert("RGB").resize((_LOOK_SIDE_PIXELS, _LOOK_SIDE_PIXELS), Image.Resampling.BOX)
                looks.append(np.asarray(small, np.float32))
        except Exception:  # decoders of damaged files raise anything
            return False
    return float(np.abs(looks[0] - looks[1]).mean()) <= _MAX_LOOK_DIFFERENCE


def _say_aside(folder: Path, what: str, names: Sequence[str]) -> None:
    if names:
        warn(f"{folder}: {len(names)} files are left aside as {what}: {listed(list(names), 3)}", 3)


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts numbers in names by their value: photo_2 before photo_10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part.lower()) for part in _DIGITS.split(name)]


def are_numbered(names: list[str]) -> bool:
    """Return whether names look like a sequence: most differ from the one before by a number, going up."""
    if len(names) < 2:
        return False
    steps = 0
    for name, following in pairwise(names):
        parts, others = _DIGITS.split(name), _DIGITS.split(following)
        differing = [k for k in range(min(len(parts), len(others))) if parts[k] != others[k]]
        if len(parts) == len(others) and len(differing) == 1 and parts[differing[0]].isdecimal():
            steps += 0 < int(others[differing[0]]) - int(parts[differing[0]]) <= MAX_NUMBER_STEP
    return steps >= MIN_NUMBERED_SHARE * (len(names) - 1)
