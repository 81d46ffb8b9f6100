"""cameras.json, which 3DGS training leaves beside its scene -> views, and back."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Matrix3, Vector3
from ..errors import FormatError, warn
from ..scene.views import View
from .json_files import as_kind, as_list, read_json, write_json
from .photo_files import listed, relative_names, safe_name
from .poses import (
    Entry,
    distortion_of,
    inverse_pose,
    nearest_rotation,
    number,
    pinhole,
    posed_view,
    refuse_other_lenses,
)


class _Camera(NamedTuple):
    img_name: str
    width: int
    height: int
    position: Vector3
    rotation: Matrix3
    fx: float
    fy: float


def read_cameras_json(path: Path) -> list[View]:
    """Read the views of a cameras.json, in the order of the file, without photos.

    position is the camera's centre, rotation camera-to-world in OpenCV axes. 3DGS itself writes no principal point (the
    raster's centre is meant) and no distortion (it trains on undistorted photos); cx, cy, k1, k2, p1 and p2 of other
    programs are read.

    Raises: FormatError: a damaged file, a missing key, a rotation that is none.
    """
    entries = as_list(read_json(path), f"{path}: a list of cameras")
    if not entries:
        raise FormatError(f"{path}: expected a list of cameras, got an empty one")
    wheres = [f"{path}, camera {index}" for index in range(len(entries))]
    cameras = [as_kind(entry, _Camera, where) for entry, where in zip(entries, wheres, strict=True)]
    names = relative_names([camera.img_name for camera in cameras])
    return [_view(*each) for each in zip(cameras, entries, names, wheres, strict=True)]


def write_cameras_json(path: str | Path, views: Sequence[View], overwrite: bool = False) -> None:
    """Write views as 3DGS does; img_name is the view's whole name.

    Warns: DrSplatWarning: views whose principal point is off the centre or whose photo is
    distorted: the format cannot say so; the warning names them.
    Raises: InputError: the file exists and `overwrite` is false, or its folder does not.
    """
    inexact = [view.name for view in views if _is_inexact(view)]
    if inexact:
        text = f"{path}: cameras.json holds neither principal point nor distortion; lost for {len(inexact)} views: "
        warn(text + listed(inexact), 3)
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
    write_json(path, entries, overwrite, end="")


def _view(camera: _Camera, entry: Entry, name: str, where: str) -> View:
    name = safe_name(name, where)
    where = f"{where} ({name!a})"
    size = (camera.width, camera.height)
    refuse_other_lenses(entry, where)
    cam_from_world = inverse_pose(nearest_rotation(camera.rotation, f"{where}: rotation"), camera.position)
    center = number(entry, "cx", where, size[0] / 2), number(entry, "cy", where, size[1] / 2)
    intrinsics = pinhole(camera.fx, camera.fy, *center)
    return posed_view(where, name, intrinsics, cam_from_world, size, distortion_of(entry, where))


def _is_inexact(view: View) -> bool:
    off_center = np.abs(view.K[:2, 2] - (view.width / 2, view.height / 2)).max() > 1e-6
    return bool(off_center) or view.distortion is not None
