"""transforms.json of nerfstudio and instant-ngp -> views."""

import math
import os
import warnings
from collections import ChainMap
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.arrays import Float64
from ..errors import DrSplatWarning, FormatError, InputError
from ..scene.views import View
from .dataparser import SceneFrame, scene_frame
from .json_files import as_count, as_matrix, as_number, excerpt, read_json
from .mask_files import IMAGE_FOLDER
from .photo_files import find_photo, listed, on_photo, safe_name
from .poses import inverse_pose, nearest_rotation, pinhole, posed_view

CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_MAX_PATH_CHARACTERS = 1024

_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])  # camera axes: y up and z backward become y down and z forward

Entry = Mapping[str, object]


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
    views, missing = [], []
    shared = _shared_folder(document)
    of_all = {key: value for key, value in document.items() if key != "time"}  # each photo has its own
    for index, frame in enumerate(document["frames"]):  # type: ignore[arg-type,var-annotated]
        where = f"{path}, frame {index}"
        given = _file_path(frame, where)
        name = safe_name(_relative(given, path.parent, shared), where)
        photo = _find(path.parent, images, name, Path(given) if shared is not None else None)
        if photo is None:
            missing.append(name)
        else:
            view = _view(ChainMap(frame, of_all), _name(name, photo), photo, where)
            views.append(replace(view, mask_path=_mask(frame, path.parent, where)))
    _report(path, missing, len(views))
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
    if not isinstance(named, str):
        raise FormatError(f"{path}: ply_file_path: expected a file's name, got {excerpt(named)}")
    if _is_absolute(named):
        return Path(named)
    return path.parent / safe_name(named, f"{path}: ply_file_path")


def _document(path: Path) -> dict[str, object]:
    document = read_json(path)
    if not isinstance(document, dict) or not isinstance(document.get("frames"), list):
        raise FormatError(f'{path}: expected a JSON object with a list of "frames"')
    if not document["frames"]:
        raise FormatError(f"{path}: the list of frames is empty")
    return document


def _view(entry: Entry, name: str, photo: Path, where: str) -> View:
    where = f"{where} ({name!a})"
    _refuse_other_lenses(entry, where)
    width, height = _size(entry, photo, where)
    distortion = tuple(_number(entry, key, where, 0.0) for key in ("k1", "k2", "p1", "p2"))
    intrinsics = _intrinsics(entry, width, height, where)
    cam_from_world = cam_from_transform(entry.get("transform_matrix"), f"{where}: transform_matrix")
    view = posed_view(where, name, intrinsics, cam_from_world, (width, height), distortion)
    time = _number(entry, "time", where, 0.0) if entry.get("time") is not None else None
    return on_photo(replace(view, time=time), photo)


def cam_from_transform(rows: object, where: str) -> Float64[np.ndarray, "4 4"]:
    """Return cam_from_world of a transform_matrix. Raises: FormatError: it is no rigid motion."""
    if isinstance(rows, list) and len(rows) == 4:
        last = as_matrix(rows[3:], 1, 4, where)
        if np.abs(last - (0, 0, 0, 1)).max() > 1e-6:
            raise FormatError(f"{where}: expected the last row 0 0 0 1, got {last[0]}")
        rows = rows[:3]
    matrix = as_matrix(rows, 3, 4, where)
    rotation = nearest_rotation(matrix[:, :3], where) * _OPENCV_FROM_OPENGL
    return inverse_pose(rotation, matrix[:, 3])


def _intrinsics(entry: Entry, width: int, height: int, where: str) -> Float64[np.ndarray, "3 3"]:
    fx = _focal(entry, "fl_x", "camera_angle_x", width, where)
    fy = _focal(entry, "fl_y", "camera_angle_y", height, where)
    fx, fy = fy if fx is None else fx, fx if fy is None else fy
    if fx is None or fy is None:
        raise FormatError(f"{where}: expected fl_x or camera_angle_x")
    cx, cy = _number(entry, "cx", where, width / 2), _number(entry, "cy", where, height / 2)
    return pinhole(fx, fy, cx, cy)


def _focal(entry: Entry, key: str, angle_key: str, side: int, where: str) -> float | None:
    if key in entry:
        return _number(entry, key, where, 0.0)
    if angle_key not in entry:
        return None
    angle = _number(entry, angle_key, where, 0.0)
    if not 0 < angle / 2 < math.pi / 2:
        raise FormatError(f"{where}: expected {angle_key} between 0 and pi radians, got {angle}")
    return side / 2 / math.tan(angle / 2)


def _size(entry: Entry, photo: Path, where: str) -> tuple[int, int]:
    if "w" in entry and "h" in entry:
        return as_count(entry["w"], f"{where}: w"), as_count(entry["h"], f"{where}: h")
    from ..scene.photos import photo_size

    return photo_size(photo)


def _refuse_other_lenses(entry: Entry, where: str) -> None:
    model = entry.get("camera_model", "OPENCV")
    higher_terms = any(_number(entry, key, where, 0.0) for key in ("k3", "k4", "k5", "k6"))
    if model not in CAMERA_MODELS or entry.get("is_fisheye") or higher_terms:
        lens = f"camera_model {excerpt(model)}" + (" with terms beyond k2" if higher_terms else "")
        raise FormatError(
            f"{where}: {lens} is not supported (supported: {', '.join(CAMERA_MODELS)} with k1, k2, p1, p2): undistort "
            "the photos first, with `colmap image_undistorter`"
        )


def _file_path(frame: object, where: str) -> str:
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise FormatError(f"{where}: expected an object with a file_path, got {excerpt(frame)}")
    path: str = frame["file_path"]
    return path


def _shared_folder(document: Mapping[str, object]) -> str | None:
    """Return the folder of all photos whose paths are absolute; None where none is."""
    frames: list[object] = document["frames"]  # type: ignore[assignment]
    paths = [frame.get("file_path") for frame in frames if isinstance(frame, dict)]
    folders = [os.path.dirname(str(path)) for path in paths if _is_absolute(path)]
    return os.path.commonpath(folders) if folders else None


def _is_absolute(path: object) -> bool:
    """Return True for a plain absolute path, without ".." and short enough for a file system."""
    if not isinstance(path, str) or not path.isprintable() or len(path) > _MAX_PATH_CHARACTERS:
        return False
    return path.startswith("/") and ".." not in path.split("/")


def _relative(path: str, base: Path, shared: str | None) -> str:
    """Return an absolute path as a relative one: below the capture where it lies there, else below `shared`."""
    if shared is None or not _is_absolute(path):
        return path
    inside = os.path.realpath(base)
    start = inside if path.startswith(inside + "/") else shared
    return os.path.relpath(path, start)


def _find(base: Path, images: Path | None, name: str, given: Path | None) -> Path | None:
    """Find a photo. given: the absolute path that the file may have."""
    if images is not None:
        return find_photo(images, _inner(name)) or find_photo(images, name)
    if given is not None and _is_absolute(str(given)) and (there := find_photo(given.parent, given.name)):
        return there
    return find_photo(base, name) or find_photo(base / "images", name)


def _mask(frame: Mapping[str, object], base: Path, where: str) -> Path | None:
    named = frame.get("mask_path")
    if named is None:
        return None
    if not isinstance(named, str):
        raise FormatError(f"{where}: mask_path: expected a file's name, got {excerpt(named)}")
    mask = Path(named) if _is_absolute(named) else base / safe_name(named, f"{where}: mask_path")
    if not mask.is_file():
        raise InputError(f"{where}: its mask_path, {mask}, is missing: put the mask there, or take the name out")
    return mask


def _name(file_path: str, photo: Path) -> str:
    inner = _inner(file_path)
    return inner + photo.name.removeprefix(Path(inner).name)


def _inner(name: str) -> str:
    first, _, rest = name.partition("/")
    return rest if rest and IMAGE_FOLDER.fullmatch(first) else name


def _number(entry: Entry, key: str, where: str, default: float) -> float:
    return as_number(entry[key], f"{where}: {key}") if key in entry else default


def _report(path: Path, missing: list[str], num_found: int) -> None:
    if missing and not num_found:
        raise InputError(
            f"{path}: none of its {len(missing)} photos exists, the first is {missing[0]}: pass images=FOLDER"
        )
    if missing:
        text = f"{path}: {len(missing)} of {len(missing) + num_found} frames left out, their photos are missing: "
        warnings.warn(text + listed(missing), DrSplatWarning, stacklevel=6)
