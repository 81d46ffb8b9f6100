"""Masks of photos, found and written: masks/ beside images/, in the photos' own folder, or beside each photo.

Source of the names: COLMAP's `ImageReader.mask_path` (masks/a.jpg.png for a.jpg); brush and nerfstudio (masks/a.png;
masks_4/ beside images_4/); RealityScan (a.jpg.mask.png beside the photo, or a folder .mask/); Metashape (a_mask.png);
instant-ngp (dynamic_mask_a.png, in which white is left out).
"""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image

from ..base.arrays import Mask
from ..errors import InputError, warn
from ..scene.photo_masks import MIN_WHITE, load_mask
from ..scene.photos import photo_size
from ..scene.views import View
from .photo_files import IMAGE_FOLDER, MASK_FOLDER, find_files, folded
from .replacing import replacing

FOLDER, SUFFIX = MASK_FOLDER, ".png"
FOLDERS = (FOLDER, "mask", ".mask")
FOLDER_NAME = re.compile(r"\.?masks?(_\d+)?")
INVERTED_PREFIX = "dynamic_mask_"
BESIDE = ("{name}.mask", "{stem}.mask", "{stem}_mask", INVERTED_PREFIX + "{stem}")  # and the suffix of a picture
_BESIDE_NAME = re.compile(rf"[._]mask\.\w+$|^{INVERTED_PREFIX}", re.IGNORECASE)
NO_NAME = "no mask in it has a photo's name: expected NAME.jpg.png or NAME.png for NAME.jpg"


def mask_folders(photos: Path) -> list[Path]:
    """Return the folders of the photos' masks: in theirs, or beside it where theirs is images or images_4."""
    if not photos.is_dir():
        return []
    size = IMAGE_FOLDER.fullmatch(photos.name)
    wanted = dict.fromkeys((f"{FOLDER}{size[1] or ''}" if size else FOLDER, *FOLDERS))
    places = [photos, photos.parent] if size else [photos]
    folders = {(k, folded(entry.name)): entry for k, place in enumerate(places) for entry in place.iterdir()}
    found = [folders[k, name] for k in range(len(places)) for name in wanted if (k, name) in folders]
    return [folder for folder in found if folder.is_dir()]


def masks_of(photos: Path, names: Sequence[str]) -> list[Path | None]:
    """Return the mask of each photo of a folder, by the photos' names in it; None where it has none."""
    folders, paths = mask_folders(photos), [PurePosixPath(name) for name in names]
    parents = {parent for parent in {path.parent for path in paths} if folders or _has_masks(photos / parent)}
    return find_files([_places(photos, folders, path) if path.parent in parents else () for path in paths])


def _has_masks(folder: Path) -> bool:
    """Return whether files in a folder are named as masks beside photos: most captures have none to look for."""
    return folder.is_dir() and any(map(_BESIDE_NAME.search, os.listdir(folder)))


def _places(photos: Path, folders: Sequence[Path], name: PurePosixPath) -> list[Path]:
    """Return where a photo's mask may lie. In a folder of masks it may have the name of the photo, too."""
    beside = [part.format(name=name.name, stem=name.stem) for part in BESIDE]
    inside = [name.name, name.stem, *beside]
    return [
        *(folder / name.parent / part for folder in folders for part in inside),
        *(photos / name.parent / part for part in beside),
    ]


def is_inverted(mask: Path) -> bool:
    """Return whether white is left out by the mask's name."""
    return mask.name.startswith(INVERTED_PREFIX)


def with_masks(views: Sequence[View], invert: bool) -> list[View]:
    """Return the views with the masks that lie beside their photos; those that have one already keep it.

    invert: black is kept, and white left out.

    Warns: DrSplatWarning: masks without a photo of their name. Raises: InputError: `invert`, and there is no mask.
    """
    by_folder: dict[Path, list[View]] = {}
    for view in views:
        if view.image_path is not None and view.mask_path is None:
            by_folder.setdefault(photo_folder(view), []).append(view)
    found: dict[str, Path | None] = {}
    for folder, some in by_folder.items():
        names = [_name_in(folder, view) for view in some]
        found |= dict(zip((view.name for view in some), masks_of(folder, names), strict=True))
    photos = {view.image_path for view in views}
    found = {name: None if mask in photos else mask for name, mask in found.items()}
    masked = [_masked(view, view.mask_path or found.get(view.name), invert) for view in views]
    if any(view.mask_path is not None for view in masked):
        return masked
    if invert:
        raise InputError("invert_masks: these photos have no masks: put them into masks/ beside images/, or drop it")
    for folder in dict.fromkeys(folder for photos in by_folder for folder in mask_folders(photos)):
        warn(f"{folder}: {NO_NAME}; photos are used whole", 4)
    return list(views)


def _masked(view: View, mask: Path | None, invert: bool) -> View:
    inverted = mask is not None and invert != is_inverted(mask)
    return replace(view, mask_path=mask, mask_inverted=inverted)


def _name_in(folder: Path, view: View) -> str:
    """Return the name of a view's photo in its folder, which may have another suffix or case than the view's name."""
    path = view.image_path or folder
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


def photo_folder(view: View) -> Path:
    """Return the folder that the view's name is relative to, by where its photo is."""
    path = view.image_path or Path(view.name)
    depth = len(Path(view.name).parts)
    same = [folded(part) for part in path.parts[-depth:-1]] == [folded(part) for part in Path(view.name).parts[:-1]]
    return path.parents[depth - 1] if same and len(path.parents) >= depth else path.parent


def write_mask(view: View, left_out: Mask, folder: Path) -> View:
    """Write a mask of a view's photo, (h, w) at any size, into a folder; returns the view with it.

    What the view's own mask leaves out stays left out.

    Raises: InputError: the view has no photo. FormatError: its photo, or its mask, is damaged.
    """
    if view.image_path is None:
        raise InputError(f"view '{view.name}' has no photo")
    size = photo_size(view.image_path)
    kept = Image.fromarray(np.where(left_out, 0, 255).astype(np.uint8)).resize(size, Image.Resampling.BILINEAR)
    white, before = np.asarray(kept) >= MIN_WHITE, load_mask(replace(view, distortion=None).resized(*size))
    path = folder / f"{view.name}{SUFFIX}"
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, overwrite=True) as file:
        Image.fromarray(white if before is None else white & before).save(file, format="PNG")
    return replace(view, mask_path=path, mask_inverted=False)
