"""Poses: entries of camera files become Views, with errors that name the entry.

Lenses in JSON camera files: those that a pinhole with k1, k2, p1, p2 stands for, and those that are refused.

Keys that change what a picture is, of whatever program, are refused by their own names: a fisheye photo that is read as
a pinhole gives no error later, only wrong places.

Source: keys that nerfstudio, instant-ngp, Blender's exporters and Metashape's write or read.

cameras.json, which 3DGS training leaves beside its scene -> views, and back.
"""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Matrix3, Matrix4, Vector3
from ..errors import FormatError, InputError, warn
from ..scene.gaussians import rotation_matrices
from ..scene.views import View
from .json_files import as_kind, as_list, as_number, as_vector, excerpt, read_json, write_json
from .photo_files import listed, relative_names, safe_name

MAX_SIDE_PIXELS = 1 << 17  # larger than any photo, small enough that a false header allocates little
MAX_COORDINATE = 1e12
MIN_FOCAL_PIXELS = 1e-3
RIGID_TOLERANCE = 1e-3


def pinhole(fx: float, fy: float, cx: float, cy: float) -> Matrix3:
    """Return K of focal lengths and principal point, all in pixels."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def pose(rotation: Matrix3, translation: Vector3) -> Matrix4:
    """Return the 4x4 of x -> rotation @ x + translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def inverse_pose(rotation: Matrix3, center: Vector3) -> Matrix4:
    """Return cam_from_world of a camera-to-world rotation and the camera's centre."""
    return pose(rotation.T, -rotation.T @ center)


def rotation_from_quaternion(quaternion: tuple[float, ...], where: str) -> Matrix3:
    """Return the rotation of (w, x, y, z), of any length. Raises: FormatError: a zero or non-finite quaternion."""
    norm = math.hypot(*quaternion)
    if not (math.isfinite(norm) and norm > 1e-12):
        raise FormatError(f"{where}: expected a rotation quaternion, got {quaternion}")
    unit = np.array([[part / norm for part in quaternion]])
    return rotation_matrices(unit)[0]


def nearest_rotation(matrix: Matrix3, where: str) -> Matrix3:
    """Return the rotation that a 3x3 written with few digits stands for.

    Raises: FormatError: the matrix scales, shears or mirrors by more than rounding.
    """
    lengths = [math.hypot(*column) for column in matrix.T]
    if max(abs(length - 1) for length in lengths) < RIGID_TOLERANCE:
        u, stretch, vt = np.linalg.svd(matrix)
        if np.abs(stretch - 1).max() < RIGID_TOLERANCE and np.linalg.det(matrix) > 0:
            return u @ vt
    raise FormatError(
        f"{where}: expected a rotation (orthonormal columns, determinant +1), got columns of lengths "
        f"{', '.join(f'{length:.6g}' for length in lengths)}: remove scale, shear or mirroring from the pose"
    )


def posed_view(
    where: str,
    name: str,
    intrinsics: Matrix3,
    cam_from_world: Matrix4,
    size: tuple[int, int],
    distortion: tuple[float, ...] = (),
) -> View:
    """Return a View of numbers from a file; `distortion` (k1, k2, p1, p2) that is all zero becomes None.

    Raises: FormatError: an impossible raster, focal length, pose or distortion.
    """
    if not (1 <= size[0] <= MAX_SIDE_PIXELS and 1 <= size[1] <= MAX_SIDE_PIXELS):
        raise FormatError(
            f"{where}: expected a raster of 1 to {MAX_SIDE_PIXELS} pixels a side, got {size[0]}x{size[1]}"
        )
    numbers = [*intrinsics.flat, *cam_from_world.flat, *distortion]
    if not all(abs(number) <= MAX_COORDINATE for number in numbers):
        raise FormatError(f"{where}: a camera parameter is not finite or beyond {MAX_COORDINATE:g}")
    if not min(intrinsics[0, 0], intrinsics[1, 1]) >= MIN_FOCAL_PIXELS:
        focal = f"{intrinsics[0, 0]:g}, {intrinsics[1, 1]:g}"
        raise FormatError(f"{where}: expected focal lengths in pixels, got {focal}")
    lens = tuple(distortion) if any(distortion) else None
    try:
        return View(name, intrinsics, cam_from_world, *size, distortion=lens)  # type: ignore[arg-type]
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


Entry = Mapping[str, object]

CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
DISTORTION = ("k1", "k2", "p1", "p2")
_AXES_KEYS = ("camera_convention", "coordinate_convention", "camera_axes")
_OPENGL_NAMES = ("opengl", "nerf", "blender", "nerfstudio")
_LENS_KEYS = ("camera_type", "lens_type", "lens_model", "lens", "projection", "projection_type", "distortion_model")
_OTHER_LENS = re.compile("fish|equi|pano|ortho|spher|omni|theta|kannala|cylind|lat_?long", re.IGNORECASE)  # in a name
_NO_PINHOLE = "not a pinhole with k1, k2, p1, p2"
_UNDISTORT = "undistort the photos first: `colmap image_undistorter` does it for a COLMAP model of them"
_CUT = "cut the panoramas into pinhole photos first, as `ns-process-data --camera-type equirectangular` does"
_ORTHOGRAPHIC = "give photos of a camera: an orthographic picture has no place that it was taken from"
_EXPORT = "export the poses for nerfstudio, in axes of OpenGL and without it"
_REFUSED = {  # keys that change the meaning where they are neither 0 nor false
    **dict.fromkeys(
        ("is_fisheye", "fisheye", "fisheye_crop_radius", "ftheta", "xi"), (f"a fisheye lens, {_NO_PINHOLE}", _UNDISTORT)
    ),
    **dict.fromkeys(("latlong", "equirectangular", "panorama", "is_panorama"), (f"a panorama, {_NO_PINHOLE}", _CUT)),
    **dict.fromkeys(("ortho", "orthographic", "is_ortho"), ("an orthographic picture", _ORTHOGRAPHIC)),
    **dict.fromkeys(
        ("k3", "k4", "k5", "k6", "p3", "p4", "s1", "s2", "s3", "s4"),
        (f"terms beyond k2 and p2, {_NO_PINHOLE}", _UNDISTORT),
    ),
    **dict.fromkeys(("b1", "b2", "skew", "skew_x"), ("sheared pixels", _UNDISTORT)),
    **dict.fromkeys(("rolling_shutter",), ("a camera that moves while it looks", _EXPORT)),
    **dict.fromkeys(("normal_mts_args", "from_mitsuba", "from_na"), ("poses in other axes than OpenGL's", _EXPORT)),
}
_PREFIXES = {"ftheta_": "ftheta"}


def cure_of(model: str) -> str:
    """Return what to do about photos of another camera model."""
    if re.search("ortho", model, re.IGNORECASE):
        return _ORTHOGRAPHIC
    return _CUT if re.search("equirect|pano|spher|lat_?long", model, re.IGNORECASE) else _UNDISTORT


def refuse_other_lenses(entry: Entry, where: str) -> None:
    """Refuse what no pinhole stands for. Raises: FormatError: names the key, what it says, and what to do."""
    for key in sorted(entry):
        name = next((name for prefix, name in _PREFIXES.items() if key.startswith(prefix)), key)
        if name in _REFUSED and _is_set(entry[key]):
            what, cure = _REFUSED[name]
            raise FormatError(f"{where}: {key} is {excerpt(entry[key])}: {what}; {cure}")
    for key in _AXES_KEYS:
        if isinstance(entry.get(key), str) and str(entry[key]).lower() not in _OPENGL_NAMES:
            raise FormatError(f"{where}: {key} is {excerpt(entry[key])}: poses in other axes than OpenGL's; {_EXPORT}")
    model = entry.get("camera_model", CAMERA_MODELS[0])
    if not isinstance(model, str) or model.upper() not in CAMERA_MODELS:
        expected = f"{_NO_PINHOLE} ({', '.join(CAMERA_MODELS)})"
        raise FormatError(f"{where}: camera_model is {excerpt(model)}: {expected}; {cure_of(str(model))}")
    for key in _LENS_KEYS:
        if isinstance(entry.get(key), str) and _OTHER_LENS.search(str(entry[key])):
            cure = cure_of(str(entry[key]))
            raise FormatError(f"{where}: {key} is {excerpt(entry[key])}: {_NO_PINHOLE}; {cure}")


def distortion_of(entry: Entry, where: str) -> tuple[float, ...]:
    """Return k1, k2, p1, p2; those of nerfstudio's distortion_params (k1, k2, k3, k4, p1, p2) where these are given."""
    if entry.get("distortion_params") is None:
        return tuple(number(entry, key, where, 0.0) for key in DISTORTION)
    k1, k2, k3, k4, p1, p2 = as_vector(entry["distortion_params"], 6, f"{where}: distortion_params").tolist()
    refuse_other_lenses({"k3": k3, "k4": k4}, f"{where}: distortion_params")
    return k1, k2, p1, p2


def intrinsics_of(entry: Entry, width: int, height: int, where: str) -> Matrix3:
    """Return K, the principal point in the middle where it is not given. Raises: FormatError: no focal length."""
    fx, fy = _focal(entry, "x", width, where), _focal(entry, "y", height, where)
    fx, fy = fy if fx is None else fx, fx if fy is None else fy
    if fx is None or fy is None:
        raise FormatError(f"{where}: expected fl_x or camera_angle_x")
    return pinhole(fx, fy, number(entry, "cx", where, width / 2), number(entry, "cy", where, height / 2))


def number(entry: Entry, key: str, where: str, default: float) -> float:
    """Return the number of a key, `default` where there is none."""
    return as_number(entry[key], f"{where}: {key}") if key in entry else default


def _focal(entry: Entry, axis: str, side: int, where: str) -> float | None:
    if f"fl_{axis}" in entry:
        return number(entry, f"fl_{axis}", where, 0.0)
    key, unit = next(
        ((key, unit) for key, unit in ((f"camera_angle_{axis}", 1.0), (f"{axis}_fov", math.pi / 180)) if key in entry),
        ("", 0),
    )  # of instant-ngp, in degrees
    if not key:
        return None
    angle = number(entry, key, where, 0.0) * unit
    if not 0 < angle / 2 < math.pi / 2:
        raise FormatError(f"{where}: expected {key} between 0 and pi radians, got {angle}")
    return side / 2 / math.tan(angle / 2)


def _is_set(value: object) -> bool:
    """Return whether a value says something: not false, 0, null, an empty text or a list of nothing but these."""
    return any(map(_is_set, value)) if isinstance(value, list) else bool(value)


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
