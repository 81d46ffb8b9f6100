"""Lenses in JSON camera files: those that a pinhole with k1, k2, p1, p2 stands for, and those that are refused.

Keys that change what a picture is, of whatever program, are refused by their own names: a fisheye photo that is read as
a pinhole gives no error later, only wrong places.

Source: keys that nerfstudio, instant-ngp, Blender's exporters and Metashape's write or read.
"""

import math
import re
from collections.abc import Mapping

import numpy as np

from ..base.arrays import Float64
from ..errors import FormatError
from .json_files import as_number, as_vector, excerpt
from .poses import pinhole

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


def intrinsics_of(entry: Entry, width: int, height: int, where: str) -> Float64[np.ndarray, "3 3"]:
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
