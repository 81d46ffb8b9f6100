"""Finding the masks of photos: masks/ beside images/, or in the photos' own folder.

Source of the names: COLMAP's `ImageReader.mask_path` (a.jpg.png for a.jpg); brush and nerfstudio (a.png).
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path, PurePosixPath

from ..errors import DrSplatWarning, InputError
from ..scene.views import View

FOLDER, SUFFIX = "masks", ".png"
IMAGE_FOLDER = re.compile(r"images(_\d+)?")
NO_NAME = "no mask in it has a photo's name: expected NAME.jpg.png or NAME.png for NAME.jpg"


def mask_folder(photos: Path) -> Path | None:
    """Return the folder of the photos' masks: masks/ in theirs, or beside it where theirs is images or images_4."""
    beside = [photos.parent / FOLDER] if IMAGE_FOLDER.fullmatch(photos.name) else []
    return next((place for place in [photos / FOLDER, *beside] if place.is_dir()), None)


def mask_of(masks: Path | None, name: str) -> Path | None:
    """Return the mask of a photo: NAME.png, as COLMAP has it (a.jpg.png), or the photo's name with .png (a.png)."""
    if masks is None:
        return None
    path = PurePosixPath(name)
    names = (name + SUFFIX, str(path.with_suffix(SUFFIX)))
    return next((masks / each for each in names if (masks / each).is_file()), None)


def with_masks(views: Sequence[View], invert: bool) -> list[View]:
    """Return the views with the masks that lie beside their photos; those that have one already keep it.

    invert: black is kept, and white left out.

    Warns: DrSplatWarning: masks without a photo of their name. Raises: InputError: `invert`, and there is no mask.
    """
    folder_of = cache(mask_folder)
    folders = {view.name: folder_of(photo_folder(view)) for view in views if view.image_path is not None}
    masked = [
        replace(view, mask_path=view.mask_path or mask_of(folders.get(view.name), view.name), mask_inverted=invert)
        for view in views
    ]
    if any(view.mask_path is not None for view in masked):
        return [view if view.mask_path is not None else replace(view, mask_inverted=False) for view in masked]
    if invert:
        raise InputError("invert_masks: these photos have no masks: put them into masks/ beside images/, or drop it")
    for folder in dict.fromkeys(filter(None, folders.values())):
        warnings.warn(f"{folder}: {NO_NAME}; photos are used whole", DrSplatWarning, stacklevel=4)
    return list(views)


def photo_folder(view: View) -> Path:
    """Return the folder that the view's name is relative to, by where its photo is."""
    path = view.image_path or Path(view.name)
    parts = Path(view.name).parts
    return path.parents[len(parts) - 1] if path.parts[-len(parts) :] == parts else path.parent
