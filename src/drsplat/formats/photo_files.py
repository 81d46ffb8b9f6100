"""Finding a capture's photos by the names that camera files use."""

import re
from dataclasses import replace
from pathlib import Path, PurePosixPath

from ..errors import FormatError, InputError, MismatchError
from ..scene.views import View, same_aspect

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".JPG", ".JPEG", ".PNG", ".webp", ".tif", ".tiff", ".bmp")
"""Tried in this order where a file names its photos without suffix."""

_MAX_NAME_BYTES = 1024
_MODEL_FOLDERS = re.compile(r"(^|/)(colmap/)?sparse(/\d+)?$")


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
            f"{where}: expected a file name relative to the image folder, without '..', got {ascii(name)[:200]}"
        )
    if len(posix.encode()) > _MAX_NAME_BYTES or any(len(part.encode()) > 240 for part in parts):
        raise FormatError(f"{where}: a file name of {len(name)} characters is longer than file systems allow")
    return "/".join(parts)


def find_photo(folder: Path, name: str) -> Path | None:
    """Return the file of that name; where there is none, of that name plus a photo's suffix."""
    exact = folder / name
    if exact.is_file():
        return exact
    with_suffix = (exact.with_name(exact.name + suffix) for suffix in PHOTO_SUFFIXES)
    return next((path for path in with_suffix if path.is_file()), None)


def capture_folder(path: Path) -> Path:
    """Return the folder of a capture that is named by itself, its model's folder or one of its files."""
    folder = path if path.is_dir() else path.parent
    return Path(_MODEL_FOLDERS.sub("", folder.as_posix()))


def image_folder(capture: Path, images: str | Path | None) -> Path:
    """Return the folder of a capture's photos: `images`, else CAPTURE/images, else CAPTURE.

    `images` is looked for inside the capture first ("images_4"). Where the capture is named by its
    model folder (CAPTURE/sparse/0), CAPTURE is the folder above "sparse" or "colmap/sparse".

    Raises: InputError: `images` is no folder.
    """
    if not (capture / "images").is_dir():
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
    if not same_aspect((width, height), (view.width, view.height)):
        raise MismatchError(
            f"{photo}: the photo is {width}x{height}, its camera {view.width}x{view.height}: another aspect ratio. Use "
            "the photos that the camera file was made of (uncropped, not rotated by EXIF)"
        )
    return view.resized(width, height)


def listed(names: list[str], most: int = 8) -> str:
    """Join the first names, and say how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
