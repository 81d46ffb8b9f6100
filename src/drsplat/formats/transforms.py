"""transforms.json of nerfstudio and instant-ngp -> views; dataparser_transforms.json: the frame of its splats."""

import os
from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Matrix4, Points
from ..errors import FormatError, InputError, warn
from ..scene.views import View
from .json_files import as_count, as_fields, as_kind, as_list, as_matrix, as_number, as_object, as_text, read_json
from .photo_files import (
    IMAGE_FOLDER,
    MASK_FOLDER,
    find_files,
    is_absolute,
    listed,
    on_photo,
    relative_names,
    safe_name,
    view_name,
)
from .poses import (
    Entry,
    distortion_of,
    intrinsics_of,
    inverse_pose,
    nearest_rotation,
    number,
    pose,
    posed_view,
    refuse_other_lenses,
)


@dataclass(frozen=True, eq=False)
class SceneFrame:
    """x_scene = scale * (transform @ x_world), a rigid 4x4 followed by a scale."""

    transform: Matrix4
    scale: float

    def after(self, applied: "SceneFrame") -> "SceneFrame":
        """Return the transform from the frame that `applied` leads to, where this one starts before it."""
        return SceneFrame(self.transform @ np.linalg.inv(applied.transform), self.scale / applied.scale)

    def points(self, points: Points) -> Points:
        """Return the world positions in the scene."""
        moved: np.ndarray = points @ self.transform[:3, :3].T + self.transform[:3, 3]
        return self.scale * moved

    def view(self, view: View) -> View:
        """Return the same camera in the scene: scaled world, scaled distances, every pixel as before."""
        rotation = view.cam_from_world[:3, :3] @ self.transform[:3, :3].T
        translation = self.scale * (view.cam_from_world[:3, 3] - rotation @ self.transform[:3, 3])
        return replace(view, cam_from_world=pose(rotation, translation))


def read_dataparser_transforms(path: Path) -> SceneFrame:
    """Read the file beside a nerfstudio config: {"transform": 3x4, "scale": s}.

    The frame it starts from is that of COLMAP, before the applied_transform of transforms.json.

    Raises: FormatError: a transform that is not rigid, a scale that is not positive.
    """
    document = as_fields(read_json(path), str(path), transform=object, scale=float)
    return scene_frame(document["transform"], document["scale"], str(path))


def scene_frame(transform: object, scale: object, where: str) -> SceneFrame:
    """Return the frame of a 3x4 (or 4x4) matrix and a number from a file."""
    rows = transform[:3] if isinstance(transform, list) else transform
    matrix = as_matrix(rows, 3, 4, f"{where}: transform")
    factor = as_number(scale, f"{where}: scale")
    if not 1e-9 < factor < 1e9:
        raise FormatError(f"{where}: expected a positive scale, got {factor}")
    rotation = nearest_rotation(matrix[:, :3], f"{where}: transform")
    return SceneFrame(pose(rotation, matrix[:, 3]), factor)


_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])  # camera axes: y up and z backward become y down and z forward


class _Files(NamedTuple):
    file_path: str
    mask_path: str | None = None


def read_transforms(path: Path, images: Path | None = None) -> list[View]:
    """Read the views of a transforms.json whose photos exist, with photos, in the order of the file.

    transform_matrix is camera-to-world in OpenGL axes (+y up, -z forward). Intrinsics (fl_x, fl_y, cx, cy or
    camera_angle_x; w, h or the photo's size; k1, k2, p1, p2; camera_model) are of the frame, else of the file.
    time, of the frame alone, is when its photo was taken. file_path is relative to the file, with or without suffix;
    with `images` it is looked for there, less a leading "images/". Names of views are less that folder, too.
    Absolute paths are taken as they are; where nothing is there any more, as paths below the folder that all share.
    mask_path, of the frame alone, is its photo's mask, as nerfstudio has it: relative to the file, or absolute.

    Warns: DrSplatWarning: frames without photo are left out; the warning names them.
    Raises: FormatError: a damaged file, a pose that is not rigid, a lens that no pinhole stands
    for. InputError: no photo at all, or a mask that is missing.
    """
    document = _document(path)
    frames: list[dict[str, object]] = document["frames"]
    files = [as_kind(frame, _Files, f"{path}, frame {index}") for index, frame in enumerate(frames)]
    given, named = [file.file_path for file in files], [file.mask_path or "" for file in files]
    names, mask_names = _relative_to(path, given, named)
    photos = find_files([_places(path.parent, images, name, file) for name, file in zip(names, given, strict=True)])
    masks = _masks(path, {k: named[k] for k, photo in enumerate(photos) if photo and named[k]}, mask_names, set(photos))
    of_all = {key: value for key, value in document.items() if key != "time"}  # each photo has its own
    views = []
    for index, (frame, name, photo) in enumerate(zip(frames, names, photos, strict=True)):
        if photo is not None:
            view = _view(ChainMap(frame, of_all), view_name(_inner(name), photo), photo, f"{path}, frame {index}")
            views.append(replace(view, mask_path=masks.get(index)))
    _report(path, [name for name, photo in zip(names, photos, strict=True) if photo is None], len(views))
    return views


def read_applied_transform(path: Path) -> SceneFrame:
    """Read the frame of transforms.json from that of COLMAP: applied_transform and applied_scale."""
    document = _document(path)
    identity = np.eye(4)[:3].tolist()
    transform, scale = (document.get("applied_transform", identity), document.get("applied_scale", 1.0))
    return scene_frame(transform, scale, f"{path}: applied")


def point_file(path: Path) -> Path | None:
    """Return the point cloud that a transforms.json names (`ply_file_path` of nerfstudio), in its frame.

    Raises: FormatError: a name that leaves the folder.
    """
    named = _document(path).get("ply_file_path")
    if named is None:
        return None
    named = as_text(named, f"{path}: ply_file_path")
    name = safe_name(relative_names([named])[0], f"{path}: ply_file_path")
    places = [Path(named)] * _is_path(named) + [path.parent / name]
    return find_files([places])[0] or places[0]


def _document(path: Path) -> dict[str, Any]:
    document = as_object(read_json(path), str(path))
    if not as_list(document.get("frames"), f"{path}: frames"):
        raise FormatError(f"{path}: the list of frames is empty")
    return document


def _view(entry: Entry, name: str, photo: Path, where: str) -> View:
    where = f"{where} ({name!a})"
    refuse_other_lenses(entry, where)
    # refuse the pose at the end of an exposure (instant-ngp) where it is not that of the photo
    ends = [key for key in ("transform_matrix_start", "transform_matrix_end") if key in entry]
    if any(entry[key] != entry.get("transform_matrix") for key in ends):
        raise FormatError(f"{where}: {' and '.join(ends)}: the camera moves while it looks; give one transform_matrix")
    width, height = _size(entry, photo, where)
    intrinsics = intrinsics_of(entry, width, height, where)
    cam_from_world = cam_from_transform(entry.get("transform_matrix"), f"{where}: transform_matrix")
    view = posed_view(where, name, intrinsics, cam_from_world, (width, height), distortion_of(entry, where))
    time = number(entry, "time", where, 0.0) if entry.get("time") is not None else None
    return on_photo(replace(view, time=time), photo)


def cam_from_transform(rows: object, where: str) -> Matrix4:
    """Return cam_from_world of a transform_matrix. Raises: FormatError: it is no rigid motion."""
    if isinstance(rows, list) and len(rows) == 4:
        last = as_matrix(rows[3:], 1, 4, where)
        if np.abs(last - (0, 0, 0, 1)).max() > 1e-6:
            raise FormatError(f"{where}: expected the last row 0 0 0 1, got {last[0]}")
        rows = rows[:3]
    matrix = as_matrix(rows, 3, 4, where)
    rotation = nearest_rotation(matrix[:, :3], where) * _OPENCV_FROM_OPENGL
    return inverse_pose(rotation, matrix[:, 3])


def _size(entry: Entry, photo: Path, where: str) -> tuple[int, int]:
    if "w" in entry and "h" in entry:
        return as_count(entry["w"], f"{where}: w"), as_count(entry["h"], f"{where}: h")
    from ..scene.photos import photo_size

    return photo_size(photo)


def _relative_to(path: Path, names: Sequence[str], masks: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return names of photos and masks as relative ones, below the capture where they lie there.

    Raises: FormatError: a name that leaves the folder.
    """
    inside = os.path.realpath(path.parent) + "/"
    relative = relative_names([name.removeprefix(inside) for name in (*names, *masks)])
    safe = [
        safe_name(name, f"{path}, frame {k % len(names)}{': mask_path' * (k >= len(names))}")
        if name or k < len(names)
        else ""
        for k, name in enumerate(relative)
    ]
    return safe[: len(names)], safe[len(names) :]


def _places(base: Path, images: Path | None, name: str, given: str) -> list[Path]:
    """Return where a photo may lie. given: the name as it is in the file, which may be an absolute path."""
    if images is not None:
        return [images / _inner(name), images / name]
    here = [base / name, base / "images" / name]
    return [Path(given), *here] if _is_path(given) else here


def _is_path(name: str) -> bool:
    """Return True for a plain absolute path of this system."""
    return name.startswith("/") and is_absolute(name)


def _masks(path: Path, named: Mapping[int, str], names: Sequence[str], photos: set[Path | None]) -> dict[int, Path]:
    """Return the masks of frames by their numbers. named: as they are in the file. names: relative, of all frames.

    Raises: InputError: a mask that is missing.
    """
    tried = [
        [Path(given)] * _is_path(given) + [path.parent / names[k], path.parent / MASK_FOLDER / names[k]]
        for k, given in named.items()
    ]
    found = dict(zip(named, find_files(tried), strict=True))
    for (k, mask), places in zip(found.items(), tried, strict=True):
        if mask is None or mask in photos:
            where = f"{path}, frame {k}: its mask_path, {places[0]}"
            raise InputError(f"{where}, is missing: put the mask there, or take the name out")
    return {k: mask for k, mask in found.items() if mask is not None}


def _inner(name: str) -> str:
    first, _, rest = name.partition("/")
    return rest if rest and IMAGE_FOLDER.fullmatch(first) else name


def _report(path: Path, missing: list[str], num_found: int) -> None:
    if missing and not num_found:
        raise InputError(
            f"{path}: none of its {len(missing)} photos exists, the first is {missing[0]}: pass images=FOLDER"
        )
    if missing:
        text = f"{path}: {len(missing)} of {len(missing) + num_found} frames left out, their photos are missing: "
        warn(text + listed(missing), 6)
