"""Photos below a folder, in natural order of their numbers."""

import os
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ...errors import InputError
from ...formats.mask_files import FOLDER as MASKS
from ...formats.mask_files import NO_NAME, mask_folder, mask_of
from ...formats.photo_files import safe_name

PHOTO_ENDS = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif"}
VIDEO_ENDS = {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi"}
MAX_PHOTOS = 50_000
MIN_NUMBERED_SHARE = 0.8  # of the photos, for all of them to count as numbered
MAX_NUMBER_STEP = 50  # between successive photos: frames of a film are often thinned out
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
    """Return the photos of a folder and its subfolders, without hidden ones and a folder of masks.

    Raises: InputError: no folder, no photo in it, or more than `MAX_PHOTOS`.
    """
    if not folder.is_dir():
        missing = "" if folder.exists() else "there is no such file or folder; "
        ends = ", ".join(sorted(end[1:] for end in VIDEO_ENDS))
        raise InputError(f"{folder}: {missing}expected a folder of photos or a video ({ends})")
    sources, masks = [], mask_folder(folder)
    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name.lower() != MASKS)
        for file in files:
            path = Path(parent, file)
            if path.suffix.lower() in PHOTO_ENDS and not file.startswith(".") and path.is_file():
                name = safe_name(path.relative_to(folder).as_posix(), str(folder))
                sources.append(_source(name, path, mask_of(masks, name)))
        if len(sources) > MAX_PHOTOS:
            raise InputError(f"{folder}: expected at most {MAX_PHOTOS:,} photos, found more: capture a part at a time")
    if not sources:
        kinds = ", ".join(sorted(end[1:] for end in PHOTO_ENDS))
        raise InputError(f"{folder}: there is no photo in it: expected files that end in {kinds}")
    if masks is not None and not any(source.mask for source in sources):
        raise InputError(f"{masks}: {NO_NAME}")
    return sorted(sources, key=lambda source: in_order(source.name))


def _source(name: str, path: Path, mask: Path | None) -> Source:
    stats = [each.stat() for each in (path, mask) if each is not None]
    return Source(name, path, sum(each.st_size for each in stats), max(each.st_mtime_ns for each in stats), mask)


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
