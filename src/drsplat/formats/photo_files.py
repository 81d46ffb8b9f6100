"""Finding a capture's files by the names that camera files use: the one place where names are resolved.

Names were often given on another system: with backslashes and drives, in letters of another case or composition (a
Mac keeps "ä" as two characters), or before the photos were converted to another format.
"""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from itertools import takewhile
from pathlib import Path, PurePosixPath

from ..errors import FormatError, InputError, MismatchError, warn
from ..scene.views import View, same_aspect

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".JPG", ".JPEG", ".PNG", ".webp", ".tif", ".tiff", ".bmp")
"""Tried in this order where a file names its photos without suffix."""

Listing = Callable[[Path], dict[str, list[Path]]]

_MAX_NAME_BYTES = 1024
MASK_FOLDER, IMAGE_FOLDER = "masks", re.compile(r"images(_\d+)?")
_MODEL_FOLDERS = re.compile(r"(^|/)(colmap/)?sparse(/[^/]+)?$")
_ROOT = re.compile(r"//[^/]+/[^/]+/|(//\?/)?[A-Za-z]:/|/")  # of a Windows share, a drive, or a Unix path
_SUFFIXES = tuple(dict.fromkeys(suffix.lower() for suffix in PHOTO_SUFFIXES))


def safe_name(name: str, where: str) -> str:
    """Return `name` with forward slashes and without "." parts: a path that stays inside its folder.

    Raises: FormatError: an absolute path, "..", control characters, or an impossible length.
    """
    posix = name.replace("\\", "/")
    parts = PurePosixPath(posix).parts
    escapes = posix.startswith("/") or ".." in parts or re.match(r"[A-Za-z]:", posix)
    unprintable = any(ord(letter) < 32 or 0xD800 <= ord(letter) < 0xE000 for letter in name)
    if not parts or escapes or unprintable:
        raise FormatError(
            f"{where}: got {ascii(name)[:200]}, expected a file name relative to the image folder, without '..': name "
            "each photo by its place in it"
        )
    if len(posix.encode()) > _MAX_NAME_BYTES or any(len(part.encode()) > 240 for part in parts):
        raise FormatError(f"{where}: a file name of {len(name)} characters is longer than file systems allow")
    return "/".join(parts)


def is_absolute(name: str) -> bool:
    """Return whether a name begins at a root: of Unix, a Windows drive (C:\\) or share (\\\\server\\share)."""
    posix = name.replace("\\", "/")
    is_plain = name.isprintable() and len(name) <= _MAX_NAME_BYTES and ".." not in posix.split("/")
    return is_plain and _ROOT.match(posix) is not None


def relative_names(names: Sequence[str]) -> list[str]:
    """Return names with forward slashes, absolute ones less the folder that all absolute ones share.

    Whoever posed the photos elsewhere left the folders of that machine in the names.
    """
    parts = [PurePosixPath(name.replace("\\", "/")).parts for name in names]
    absolute = [is_absolute(name) for name in names]
    folders = [[folded(part) for part in each[:-1]] for each, is_one in zip(parts, absolute, strict=True) if is_one]
    pairs = zip(min(folders, default=[]), max(folders, default=[]), strict=False)
    shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
    return ["/".join(each[shared:] if is_one else each) for each, is_one in zip(parts, absolute, strict=True)]


def folded(name: str) -> str:
    """Return a name as it is compared with another system's: without case, with letters composed."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def by_folded(names: Iterable[str]) -> dict[str, str]:
    """Return names by their folded ones, without those that differ in nothing else."""
    alike: dict[str, list[str]] = defaultdict(list)
    for name in names:
        alike[folded(name)].append(name)
    return {key: found[0] for key, found in alike.items() if len(found) == 1}


def find_files(places: Sequence[Sequence[Path]]) -> list[Path | None]:
    """Return the file of each name, None where there is none, or more than one that could be meant.

    places: for each name the paths at which its file may lie, the likeliest first. A path is tried as it is, then with
    a photo's suffix behind it (cameras.json has names without), then in letters of any case and composition, at last
    with another photo's suffix. A file that lies exactly where a name says is no other name's.

    Warns: DrSplatWarning: files that were found under another suffix, and names without one that fit several; once.
    """
    unique = {tuple(paths): next(filter(None, map(_exact, paths)), None) for paths in places}
    listing, taken, converted = cache(_listing), set(unique.values()), []
    for paths in [paths for paths, exact in unique.items() if exact is None]:
        for spellings in (_spellings, _converted):
            alike = ([file for each in spellings(path) for file in _alike(each, listing)] for path in paths)
            file = next(filter(None, (_only(files, taken) for files in alike)), None)
            if file is not None:
                converted += [f"{file.name} for {paths[0].name}"] * (spellings is _converted)
                break
        unique[paths] = file
        taken.add(file)
    several = [
        f"{file.name} of {', '.join(others)}" for file, others in map(_rivals, unique.items()) if len(others) > 1
    ]
    if several:
        text = f"{len(several)} of {len(places)} names without suffix fit several files: {listed(several, 3)} is taken"
        warn(text, 3)
    if converted:
        text = f"{len(converted)} of {len(places)} files have another suffix on disk: {listed(converted, 3)} is taken"
        warn(text, 3)
    return [unique[tuple(paths)] for paths in places]


def view_name(name: str, photo: Path) -> str:
    """Return the name of a view: that of the camera file, with the photo's suffix where it has none."""
    stem = name.rpartition("/")[2]
    return name + photo.name.removeprefix(stem) if photo.name.startswith(stem) else name


def _exact(path: Path) -> Path | None:
    places = (path, *(path.with_name(path.name + suffix) for suffix in PHOTO_SUFFIXES))
    return next((place for place in places if place.is_file()), None)


def _rivals(found: tuple[Sequence[Path], Path | None]) -> tuple[Path, list[str]]:
    """Return the file of a name without suffix, and the names of all files that would be as good; none of others."""
    paths, file = found
    if file is None or any(path.name == file.name for path in paths):
        return Path(), []
    stem = next((path.name for path in paths if file.name.startswith(path.name)), file.name)
    return file, [name for suffix in _SUFFIXES if file.with_name(name := stem + suffix).is_file()]


def _spellings(path: Path) -> list[Path]:
    """Return a path, and where it has no photo's suffix, with each."""
    more = [] if path.suffix.lower() in _SUFFIXES else [path.with_name(path.name + suffix) for suffix in _SUFFIXES]
    return [path, *more]


def _converted(path: Path) -> list[Path]:
    """Return a path with each other photo's suffix in place of one that it has."""
    return [path.with_suffix(suffix) for suffix in _SUFFIXES] if path.suffix.lower() in _SUFFIXES else []


def _only(files: Sequence[Path], taken: set[Path | None]) -> Path | None:
    left = [file for file in files if file not in taken and file.is_file()]
    return left[0] if len(left) == 1 else None


def _alike(path: Path, listing: Listing) -> list[Path]:
    """Return what lies at a path but for case and composition of its letters."""
    known = next(parent for parent in path.parents if parent.is_dir())
    found = [known]
    for part in path.relative_to(known).parts:
        found = [entry for place in found for entry in listing(place).get(folded(part), [])]
    return found


def _listing(folder: Path) -> dict[str, list[Path]]:
    """Return the entries of a folder by their folded names."""
    entries: dict[str, list[Path]] = defaultdict(list)
    for entry in folder.iterdir() if folder.is_dir() else ():
        entries[folded(entry.name)].append(entry)
    return entries


def capture_folder(path: Path) -> Path:
    """Return the folder of a capture that is named by itself, its model's folder or one of its files."""
    folder = path if path.is_dir() else path.parent
    if (folder / "images").is_dir():
        return folder
    if folder.name.isdecimal() and (folder.parent / "images").is_dir():
        return folder.parent
    has_cameras = any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt"))
    is_named_so = folder.parent.name == "sparse" and not folder.name.isdecimal() and not has_cameras
    return folder if is_named_so else Path(_MODEL_FOLDERS.sub("", folder.as_posix()))


def image_folder(capture: Path, images: str | Path | None) -> Path:
    """Return the folder of a capture's photos: `images`, else CAPTURE/images, else CAPTURE.

    `images` is looked for inside the capture first ("images_4"). Where the capture is named by its
    model folder (CAPTURE/sparse/0), CAPTURE is the folder above "sparse" or "colmap/sparse".

    Raises: InputError: `images` is no folder.
    """
    capture = capture_folder(capture)
    if images is None:
        return capture / "images" if (capture / "images").is_dir() else capture
    for folder in (capture / images, Path(images)):
        if folder.is_dir():
            return folder
    raise InputError(f"images: there is no folder '{images}', neither in {capture} nor as a path of its own")


def on_photo(view: View, path: Path) -> View:
    """Return the view with its photo, K and size scaled to the photo's own raster.

    Raises: FormatError: not a photo. MismatchError: the photo has another shape than the camera.
    """
    from ..scene.photos import photo_size

    return replace(on_raster(view, photo_size(path), str(path)), image_path=path)


def on_raster(view: View, size: tuple[int, int], photo: str) -> View:
    """Return the view with K and size scaled to its photo's raster. photo: names it in the error.

    Raises: MismatchError: the photo has another shape than the camera.
    """
    width, height = size
    if not same_aspect((width, height), view.size):
        raise MismatchError(
            f"{photo}: the photo is {width}x{height}, its camera {view.width}x{view.height}: another aspect ratio. Use "
            "the photos that the camera file was made of (uncropped, not rotated by EXIF)"
        )
    return view.resized(width, height)


def listed(names: list[str], most: int = 8) -> str:
    """Join the first names, and say how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
