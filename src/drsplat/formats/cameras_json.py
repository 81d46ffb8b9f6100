"""cameras.json, which 3DGS training leaves beside its scene -> views, and back."""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import DrSplatWarning, FormatError
from ..scene.views import View
from .json_files import as_count, as_matrix, as_number, as_vector, excerpt, read_json
from .lenses import Entry, distortion_of, number, refuse_other_lenses
from .photo_files import listed, relative_names, safe_name
from .poses import inverse_pose, nearest_rotation, pinhole, posed_view
from .replacing import replacing

KEYS = ("img_name", "width", "height", "position", "rotation", "fx", "fy")


def read_cameras_json(path: Path) -> list[View]:
    """Read the views of a cameras.json, in the order of the file, without photos.

    position is the camera's centre, rotation camera-to-world in OpenCV axes. 3DGS itself writes no principal point (the
    raster's centre is meant) and no distortion (it trains on undistorted photos); cx, cy, k1, k2, p1 and p2 of other
    programs are read.

    Raises: FormatError: a damaged file, a missing key, a rotation that is none.
    """
    document = read_json(path)
    if not isinstance(document, list) or not document:
        raise FormatError(f"{path}: expected a JSON list of cameras, got {excerpt(document)}")
    wheres = [f"{path}, camera {index}" for index in range(len(document))]
    names = relative_names([_name(entry, where) for entry, where in zip(document, wheres, strict=True)])
    return [_view(entry, name, where) for entry, name, where in zip(document, names, wheres, strict=True)]


def write_cameras_json(path: str | Path, views: Sequence[View], overwrite: bool = False) -> None:
    """Write views as 3DGS does; img_name is the view's whole name.

    Warns: DrSplatWarning: views whose principal point is off the centre or whose photo is
    distorted: the format cannot say so; the warning names them.
    Raises: InputError: the file exists and `overwrite` is false, or its folder does not.
    """
    inexact = [view.name for view in views if _is_inexact(view)]
    if inexact:
        text = f"{path}: cameras.json holds neither principal point nor distortion; lost for {len(inexact)} views: "
        warnings.warn(text + listed(inexact), DrSplatWarning, stacklevel=3)
    entries = [
        {
            "id": index,
            "img_name": view.name,
            "width": view.width,
            "height": view.height,
            "position": view.center.tolist(),
            "rotation": view.cam_from_world[:3, :3].T.tolist(),
            "fy": float(view.K[1, 1]),
            "fx": float(view.K[0, 0]),
        }
        for index, view in enumerate(views)
    ]
    with replacing(path, overwrite) as file:
        file.write(json.dumps(entries, indent=1).encode())


def _name(entry: object, where: str) -> str:
    if not isinstance(entry, dict) or not entry.keys() >= set(KEYS):
        raise FormatError(f"{where}: expected an object with {', '.join(KEYS)}, got {excerpt(entry)}")
    if not isinstance(entry["img_name"], str):
        raise FormatError(f"{where}: expected img_name to be text, got {excerpt(entry['img_name'])}")
    return str(entry["img_name"])


def _view(entry: Entry, name: str, where: str) -> View:
    name = safe_name(name, where)
    where = f"{where} ({name!a})"
    size = (as_count(entry["width"], f"{where}: width"), as_count(entry["height"], f"{where}: height"))
    focal = as_number(entry["fx"], f"{where}: fx"), as_number(entry["fy"], f"{where}: fy")
    rotation = nearest_rotation(as_matrix(entry["rotation"], 3, 3, f"{where}: rotation"), f"{where}: rotation")
    center = as_vector(entry["position"], 3, f"{where}: position")
    refuse_other_lenses(entry, where)
    intrinsics = pinhole(*focal, number(entry, "cx", where, size[0] / 2), number(entry, "cy", where, size[1] / 2))
    return posed_view(where, name, intrinsics, inverse_pose(rotation, center), size, distortion_of(entry, where))


def _is_inexact(view: View) -> bool:
    off_center = np.abs(view.K[:2, 2] - (view.width / 2, view.height / 2)).max() > 1e-6
    return bool(off_center) or view.distortion is not None
