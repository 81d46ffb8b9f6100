"""COLMAP sparse models (3.x and 4.x, text or binary) -> views and points."""

from pathlib import Path
from types import ModuleType

import numpy as np

from ..base.arrays import Colors, Points
from ..errors import FormatError, InputError
from ..scene.views import View
from . import colmap_binary, colmap_text
from .colmap_binary import CameraRecord, ImageRecord, parameter_names
from .photo_files import relative_names, safe_name
from .poses import pinhole, pose, posed_view, rotation_from_quaternion

MODEL_FOLDERS = ("sparse", "colmap/sparse", ".")
_MAX_MODELS = 100  # that are looked at
_PARSERS = {".bin": colmap_binary, ".txt": colmap_text}  # in this order, as COLMAP itself prefers


def find_models(capture: Path) -> list[Path]:
    """Return the folders of a capture that hold cameras and images of a COLMAP model, the one to read first.

    Looked for in CAPTURE/sparse, CAPTURE/colmap/sparse and CAPTURE: in their folders 0, 1, ... and in themselves.
    COLMAP leaves several models where photos do not all fit together; their frames do not agree, and the first that it
    writes need not be the largest. So of one place that with most photos comes first, of several the first place's.
    """
    found: list[Path] = []
    for place in (capture / name for name in MODEL_FOLDERS):
        inner = [entry for entry in place.glob("*") if entry.name.isdecimal() or place != capture]
        ordered = sorted(inner, key=lambda entry: (not entry.name.isdecimal(), entry.name.zfill(9)))
        models = [folder for folder in (*ordered[:_MAX_MODELS], place) if _suffix_of(folder, "cameras", "images")]
        found += sorted(models, key=lambda folder: -num_images(folder)) if len(models) > 1 else models
    return found


def incomplete_model(capture: Path) -> InputError | None:
    """Return the error of a capture that has one of the two files that every model has, and None of others."""
    places = [place for name in MODEL_FOLDERS for place in (capture / name, *(capture / name).glob("*"))]
    for place in places[:_MAX_MODELS]:
        for one, other in (("cameras", "images"), ("images", "cameras")):
            there = next((f"{one}{suffix}" for suffix in _PARSERS if (place / f"{one}{suffix}").is_file()), "")
            if there and place != capture:
                text = f"{place}: got {there} without {other}, expected both of a COLMAP model: copy it whole"
                return InputError(text)
    return None


def num_images(model: Path) -> int:
    """Return the number of images of a model, 0 where its file is damaged."""
    return _num_images(model, _suffix_of(model, "cameras", "images"))


def num_unread_images(model: Path) -> int:
    """Return the number of images in an images.txt beside the images.bin that is read, 0 where these are as many."""
    both = all((model / f"{stem}{suffix}").is_file() for stem in ("cameras", "images") for suffix in _PARSERS)
    text = _num_images(model, ".txt") if both else 0
    return text if both and text != num_images(model) else 0


def _num_images(model: Path, suffix: str) -> int:
    try:
        return sum(1 for _ in _PARSERS[suffix].images(model / f"images{suffix}"))
    except FormatError:
        return 0


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
    images = list(parser.images(path))
    names = relative_names([record.name for record in images])
    return [_view(record._replace(name=name), cameras, path) for record, name in zip(images, names, strict=True)]


def read_points(capture: str | Path) -> tuple[Points, Colors]:
    """Read the sparse points of a COLMAP capture: world positions and RGB colours, in file order.

    Raises: InputError: the capture has no points3D file. FormatError: it is damaged, or a point is not finite.
    """
    places = [*find_models(Path(capture)), Path(capture), Path(capture, "sparse/0"), Path(capture, "sparse")]
    folder = next((place for place in places if has_points(place)), None)
    if folder is None:
        raise InputError(f"{capture}: expected points3D.bin or points3D.txt in it, in sparse/0 or in sparse")
    parser, suffix = _parser(folder, "points3D")
    path = folder / f"points3D{suffix}"
    records = list(parser.points(path))
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
    suffix = _suffix_of(folder, *stems)
    if not suffix:
        raise InputError(f"{folder}: expected {' and '.join(stems)} as .bin or .txt")
    return _PARSERS[suffix], suffix


def _suffix_of(folder: Path, *stems: str) -> str:
    """Return the suffix of the files of a model, "" where they are not all there."""
    return next((s for s in _PARSERS if all((folder / f"{stem}{s}").is_file() for stem in stems)), "")


def has_points(folder: Path) -> bool:
    """Return True if a model folder has a points3D file."""
    return bool(_suffix_of(folder, "points3D"))
