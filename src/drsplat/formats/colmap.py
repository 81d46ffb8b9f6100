"""COLMAP sparse models (3.x and 4.x, text or binary) -> views and points."""

from pathlib import Path
from types import ModuleType

import numpy as np

from ..base.arrays import Float64, UInt8
from ..errors import FormatError, InputError
from ..scene.views import View
from . import colmap_binary, colmap_text
from .colmap_records import CameraRecord, ImageRecord, PointRecord, parameter_names
from .photo_files import safe_name
from .poses import pinhole, pose, posed_view, rotation_from_quaternion

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", ".")
_PARSERS = {".bin": colmap_binary, ".txt": colmap_text}  # in this order, as COLMAP itself prefers


def find_model(capture: Path) -> Path | None:
    """Return the folder of a capture that holds cameras and images of one COLMAP model, or None.

    Looked for in CAPTURE/sparse/0, CAPTURE/sparse, CAPTURE/colmap/sparse/0 and CAPTURE. COLMAP may
    leave several models (sparse/1, ...), whose frames do not agree: name such a folder to read it.
    """
    for folder in (capture / name for name in MODEL_FOLDERS):
        if any(_has(folder, suffix, "cameras", "images") for suffix in _PARSERS):
            return folder
    return None


def read_colmap(model: Path) -> list[View]:
    """Read the views of a model folder, in the order of the file, without photos.

    rigs and frames files of COLMAP 4 are not needed: images carry their own poses.

    Raises: FormatError: a damaged file, an unknown camera, a lens that is no pinhole with up to two
    radial and two tangential terms (`colmap image_undistorter` turns any lens into one).
    Source: https://colmap.github.io/format.html
    """
    parser, suffix = _parser(model, "cameras", "images")
    path = model / f"images{suffix}"
    cameras = {record.camera_id: record for record in parser.cameras(model / f"cameras{suffix}")}
    return [_view(record, cameras, path) for record in parser.images(path)]


def read_points(capture: str | Path) -> tuple[Float64[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Read the sparse points of a COLMAP capture: world positions and RGB colours, in file order.

    Raises: InputError: the capture has no points3D file. FormatError: it is damaged, or a point is not finite.
    """
    folder = next((f for f in map(Path(capture).joinpath, MODEL_FOLDERS) if has_points(f)), None)
    if folder is None:
        raise InputError(f"{capture}: expected points3D.bin or points3D.txt in one of {', '.join(MODEL_FOLDERS)}")
    parser, suffix = _parser(folder, "points3D")
    path = folder / f"points3D{suffix}"
    return _point_arrays(list(parser.points(path)), path)


def _point_arrays(
    records: list[PointRecord], path: Path
) -> tuple[Float64[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    positions = np.array([record[:3] for record in records], np.float64).reshape(-1, 3)
    bad = np.flatnonzero(~np.isfinite(positions).all(1))
    if len(bad):
        raise FormatError(f"{path}: {len(bad)} of {len(records)} points are not finite, the first at index {bad[0]}")
    if any(not 0 <= channel <= 255 for record in records for channel in record[3:]):
        raise FormatError(f"{path}: expected colours in 0..255")
    return positions, np.array([record[3:] for record in records], np.uint8).reshape(-1, 3)


def _view(record: ImageRecord, cameras: dict[int, CameraRecord], path: Path) -> View:
    where = f"{path}, image {record.name!a}"
    if record.camera_id not in cameras:
        raise FormatError(f"{where}: camera {record.camera_id} is not in the cameras file")
    camera = cameras[record.camera_id]
    lens = _lens(camera, f"{path.parent}, camera {camera.camera_id}")
    intrinsics = pinhole(lens.get("fx", lens.get("f", 0.0)), lens.get("fy", lens.get("f", 0.0)), lens["cx"], lens["cy"])
    cam_from_world = pose(rotation_from_quaternion(record.quaternion, where), np.array(record.translation))
    distortion = tuple(lens.get(name, 0.0) for name in ("k1", "k2", "p1", "p2"))
    name = safe_name(record.name, where)
    return posed_view(where, name, intrinsics, cam_from_world, (camera.width, camera.height), distortion)


def _lens(camera: CameraRecord, where: str) -> dict[str, float]:
    names = parameter_names(camera.model, where)
    if len(names) != len(camera.parameters):
        raise FormatError(
            f"{where}: {camera.model} has parameters {' '.join(names)}, got {len(camera.parameters)} numbers"
        )
    return dict(zip(names, camera.parameters, strict=True))


def _parser(folder: Path, *stems: str) -> tuple[ModuleType, str]:
    for suffix, parser in _PARSERS.items():
        if _has(folder, suffix, *stems):
            return parser, suffix
    raise InputError(f"{folder}: expected {' and '.join(stems)} as .bin or .txt")


def _has(folder: Path, suffix: str, *stems: str) -> bool:
    return all((folder / f"{stem}{suffix}").is_file() for stem in stems)


def has_points(folder: Path) -> bool:
    """Return True if a model folder has a points3D file."""
    return any(_has(folder, suffix, "points3D") for suffix in _PARSERS)
