"""A capture of any supported kind -> views, sorted by name, with the times of a table or of a pattern of names.

Small tables that people write: a line of column names, then a line for each row.
"""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Colors, Points, Vector3
from ..base.contents import file_text
from ..errors import DrSplatWarning, FormatError, InputError, warn
from ..scene.views import View
from .colmap import find_models, has_points, incomplete_model, num_images, num_unread_images, read_colmap, read_points
from .json_files import read_json
from .live_views import ADDED_POSES, read_live_views, stem_of
from .mask_files import with_masks
from .photo_files import by_folded, capture_folder, find_files, folded, image_folder, listed, on_photo, view_name
from .ply import read_point_ply
from .poses import read_cameras_json
from .rendering_record import with_renderings
from .scenes import CAMERAS, TRAIN_TRANSFORMS, TRANSFORMS, Kind, mistaken
from .transforms import SceneFrame, point_file, read_applied_transform, read_dataparser_transforms, read_transforms

FILE_NAME = "dataparser_transforms.json"

MAX_ROWS = 1_000_000


def read_rows(path: Path, columns: tuple[str, ...], each: str) -> list[list[str]]:
    """Return the rows of a table below the line of its columns; how many cells each has is not checked.

    each: what a row holds, for messages.

    Raises: InputError: there is no such file. FormatError: no table of these columns, or more than `MAX_ROWS`.
    """
    import csv

    try:
        rows = list(csv.reader(file_text(path).splitlines(), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path}: expected a table in UTF-8: {error}") from None
    if not rows or tuple(cell.strip() for cell in rows[0]) != columns or len(rows) > MAX_ROWS:
        raise FormatError(f"{path}: expected the line '{','.join(columns)}', and then {each} in each")
    return rows[1:]


HOLE = "{time}"
_NUMBER = r"([0-9]{1,15}(?:\.[0-9]{1,15})?)"


PHOTO_FOLDERS = ("images", "input", "rgb", "frames", "photos")  # of a capture; input is that of 3DGS' convert.py
CAMERA_FILES = (("transforms", TRANSFORMS), ("transforms", TRAIN_TRANSFORMS), ("cameras", CAMERAS))


class SparsePoints(NamedTuple):
    """World positions and RGB of the points that the cameras were posed by."""

    positions: Points
    colors: Colors

    def moved(self, by: Vector3) -> "SparsePoints":
        """Return the points moved by a vector."""
        return SparsePoints(self.positions + by, self.colors) if by.any() else self


class _Source(NamedTuple):
    kind: str
    path: Path


def read_views(
    capture: str | Path,
    *,
    images: str | Path | None = None,
    dataparser_transforms: str | Path | None = None,
    max_side: int | None = None,
    times: str | Path | None = None,
    invert_masks: bool = False,
) -> list[View]:
    """Read the posed photos of a capture, sorted by name.

    capture: a folder with a COLMAP model (see `colmap.find_models`), a transforms.json, a
    transforms_train.json (of which a transforms_test.json beside it is no part) or a cameras.json,
    looked for in this order; or one of these files, to choose another than the first.
    images: the folder of the photos, absolute or inside the capture ("images_4"); default
    CAPTURE/images, else CAPTURE. Where photos have another size than the camera file says, K and
    size follow the photos.
    dataparser_transforms: nerfstudio's file of that name, for splats trained by it: views are moved
    to x_scene = scale * (transform @ x_world). A dataparser_transforms.json directly in the
    capture's folder is used without being named. transforms.json's own applied_transform is
    accounted for.
    max_side: photos with a longer side, in pixels, are scaled down to it.
    times: when the photos were taken, see `captures.with_times`; None: what a transforms.json says (`time`), if it
    does.
    invert_masks: in the masks of the photos (masks/ beside images/, see `mask_files`) black is kept, not white.
    Views that were sent to the scene and added (`live_views`) belong to it, in the coordinates of the scene, but for
    those whose photos the camera file has as well.

    Warns: DrSplatWarning: several camera files (which one was read); photos that are missing
    (COLMAP, cameras.json: the views stay, without image_path; transforms.json: they are left out); masks of other names
    than the photos'.
    Raises: InputError: nothing to read, no such folder, or no masks to invert. FormatError: a damaged file, a name that
    leaves the image folder or occurs twice, an unsupported lens. MismatchError: photos of another shape.

    >>> [view.name for view in ds.read_views("capture")][:2]
    ['photo_0.png', 'photo_1.png']
    """
    if max_side is not None and max_side < 1:
        raise InputError(f"max_side: expected at least 1 pixel, got {max_side}")
    source = _find_source(Path(capture))
    views = _read(source, images)
    frame = _scene_frame(source, Path(capture), dataparser_transforms)
    if frame is not None:
        views = [frame.view(view) for view in views]
    views = with_masks([view.limited(max_side) for view in _sorted(views, source.path)], invert_masks)
    views = with_renderings(views, source.path)
    views = views if times is None else with_times(views, times)
    return _with_live(views, capture_folder(Path(capture)), max_side)


def read_sparse_points(
    capture: str | Path, *, points: str | Path | None = None, dataparser_transforms: str | Path | None = None
) -> SparsePoints | None:
    """Read the points of a capture in the frame of its views, or None where it has none.

    Arguments as for `read_views`. COLMAP models have points, and a transforms.json may name some
    (`ply_file_path`). points: a PLY to read instead, in the frame of the capture's own camera file.

    Warns: DrSplatWarning: the file that transforms.json names is missing.
    Raises: InputError: there is no such capture, or no such file of points. FormatError: a damaged
    file, points that are not finite.

    >>> points = ds.read_sparse_points("colmap")
    >>> points.positions.shape
    (300, 3)
    """
    with warnings.catch_warnings():  # read_views has them
        warnings.simplefilter("ignore", DrSplatWarning)
        source = _find_source(Path(capture))
    found = _points_of(source) if points is None else read_point_ply(points)
    if found is None or len(found[0]) == 0:
        return None
    frame = _scene_frame(source, Path(capture), dataparser_transforms)
    return SparsePoints(found[0] if frame is None else frame.points(found[0]), found[1])


def _with_live(views: list[View], capture: Path, max_side: int | None) -> list[View]:
    """Return the views with those that arrived while the scene was in use."""
    present = {stem_of(view.name) for view in views}
    arrived = [view.limited(max_side) for view in read_live_views(capture) if stem_of(view.name) not in present]
    return sorted([*views, *arrived], key=lambda view: view.name) if arrived else views


def _points_of(source: _Source) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the points in the frame of the camera file."""
    if source.kind == "colmap" and has_points(source.path):
        return read_points(source.path)
    named = point_file(source.path) if source.kind == "transforms" else None
    if named is None:
        return None
    if not named.is_file():
        text = f"{source.path}: its ply_file_path, {named}, is missing: name one with points=FILE"
        warn(text, 3)
        return None
    return read_point_ply(named)


def _find_source(capture: Path) -> _Source:
    if capture.is_file():
        if capture.suffix in (".bin", ".txt"):
            return _Source("colmap", capture.parent)
        if capture.suffix != ".json":
            raise mistaken(capture, Kind.CAPTURE)
        return _Source("cameras" if isinstance(read_json(capture), list) else "transforms", capture)
    if not capture.is_dir():
        raise mistaken(capture, Kind.CAPTURE)
    models = find_models(capture)
    found = [_Source("colmap", model) for model in models]
    found += [_Source(kind, capture / name) for kind, name in CAMERA_FILES if (capture / name).is_file()]
    if not found and (capture / ADDED_POSES).is_dir():
        return _Source("live", capture)
    if not found:
        raise incomplete_model(capture) or mistaken(capture, Kind.CAPTURE)
    unread = num_unread_images(models[0]) if models else 0
    if unread:
        text = f"{models[0]}: images.bin was read, not images.txt, with {unread} photos: take away the one that is old"
        warn(text, 4)
    if len(found) > 1:  # their frames do not agree
        counts = dict(zip(models, map(num_images, models), strict=True)) if len(models) > 1 else {}
        sizes = {path: f" ({count} photos)" for path, count in counts.items()}
        said = [f"{source.path}{sizes.get(source.path, '')}" for source in found]
        text = f"{capture}: cameras were read from {said[0]}, not from {listed(said[1:])}: name a file to choose it"
        warn(text, 4)
    return found[0]


def _read(source: _Source, images: str | Path | None) -> list[View]:
    if source.kind == "live":  # all of its views arrived
        return []
    if source.kind == "transforms":
        folder = None if images is None else image_folder(source.path.parent, images)
        return read_transforms(source.path, folder)
    if source.kind == "colmap":
        return _with_photos(read_colmap(source.path), source.path, images)
    return _with_photos(read_cameras_json(source.path), source.path, images)


def _with_photos(views: list[View], path: Path, images: str | Path | None) -> list[View]:
    if not views:
        raise FormatError(f"{path}: holds no image")
    folder, capture = image_folder(path, images), capture_folder(path)
    places = [folder, folder.parent] if images else [folder, capture, *(capture / name for name in PHOTO_FOLDERS)]
    found = find_files([[place / view.name for place in places] for view in views])
    missing = [view.name for view, photo in zip(views, found, strict=True) if photo is None]
    if missing:
        text = f"{path}: {len(missing)} of {len(views)} views have no photo in {folder}: {listed(missing)}"
        warn(text, 5)
    return [
        view if photo is None else on_photo(replace(view, name=view_name(view.name, photo)), photo)
        for view, photo in zip(views, found, strict=True)
    ]


def _scene_frame(source: _Source, capture: Path, named: str | Path | None) -> SceneFrame | None:
    beside = (capture if capture.is_dir() else capture.parent) / FILE_NAME
    if named is None and not beside.is_file():
        return None
    frame = read_dataparser_transforms(beside if named is None else Path(named))
    return frame.after(read_applied_transform(source.path)) if source.kind == "transforms" else frame


def _sorted(views: list[View], path: Path) -> list[View]:
    ordered = sorted(views, key=lambda view: view.name)
    twice = [a.name for a, b in pairwise(ordered) if a.name == b.name]
    if twice:
        raise FormatError(f"{path}: {len(twice)} image names occur more than once: {listed(twice)}")
    return ordered


def with_times(views: Sequence[View], times: str | Path) -> list[View]:
    """Return every view with its time.

    times: the name of a table, NAME.csv, with a line "name,time" first; or a pattern of names such as
    "cam*/frame_{time}.png": {time} stands for the number that is the time, * for anything within a folder's or file's
    name, and all of the name has to fit, but for its suffix where the pattern has none.

    Raises: InputError: no such table, no {time} in the pattern, or views that have no time by it. FormatError: a
    damaged table.
    """
    text = str(times)
    if HOLE in text:
        before, _, after = text.partition(HOLE)
        if HOLE in after:
            raise InputError(f"times: expected {HOLE} once in {text!r}")
        parts = (re.escape(part).replace(r"\*", "[^/]*?") for part in (before, after))
        suffix = "" if Path(text).suffix else r"(?:\.[^./]+)?"
        whole = re.compile(_NUMBER.join(parts) + suffix)
        fits = {view.name: whole.fullmatch(view.name) for view in views}
        found = {name: float(fit[1]) for name, fit in fits.items() if fit}
    elif text.lower().endswith(".csv"):
        found = read_times(Path(times))
    else:
        raise InputError(f"times: expected a table NAME.csv, or a pattern such as cam*/frame_{HOLE}.png; got {text!r}")
    found = {key: found[name] for key, name in by_folded(found).items()} | found
    missing = [view.name for view in views if _key(view, found) is None]
    if missing:
        raise InputError(f"{len(missing)} of {len(views)} views have no time by {text!r}: {listed(missing)}")
    return [replace(view, time=found[key]) for view in views if (key := _key(view, found)) is not None]


def read_times(path: Path) -> dict[str, float]:
    """Read the times of a table by the names of photos, with or without suffix.

    Raises: InputError: there is no such file. FormatError: not a table of names and finite numbers, or a name twice.
    """
    found: dict[str, float] = {}
    for number, row in enumerate(read_rows(path, ("name", "time"), "a name and a number"), 2):
        name, time = _row(row, f"{path}, line {number}")
        if name in found:
            raise FormatError(f"{path}, line {number}: '{name}' is there twice")
        found[name] = time
    return found


def _row(row: list[str], where: str) -> tuple[str, float]:
    try:
        name, time = row[0].strip(), float(row[1])
        if len(row) == 2 and math.isfinite(time):
            return name, time
    except (ValueError, IndexError):
        pass
    raise FormatError(f"{where}: expected a name and a finite number, got {ascii(','.join(row))[:80]}")


def _key(view: View, found: Mapping[str, float]) -> str | None:
    stem = str(Path(view.name).with_suffix("").as_posix())
    return next((key for key in (view.name, stem, folded(view.name), folded(stem)) if key in found), None)
