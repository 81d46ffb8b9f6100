"""Camera paths on disk: our own key frames, and nerfstudio's camera_path.json."""

import json
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import FormatError, InputError
from ...formats.json_files import as_count, as_number, as_vector, excerpt, read_json
from ...formats.poses import MAX_COORDINATE, nearest_rotation
from ...formats.replacing import replacing
from .looking import FOV_DEGREES, looking_at
from .paths import MAX_KEYS, CameraPath, KeyFrame, check_size, frame_count

KIND, VERSION = "drsplat-path", 1
_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])
Entry = Mapping[str, object]


def read_path(path: str | PathLike[str]) -> CameraPath:
    """Read key frames of ours, or nerfstudio's camera_path.json, in the frame of the scene.

    Of nerfstudio its pictures are the key frames (`camera_path`: camera_to_world in OpenGL axes, fov in degrees from
    top to bottom), passed in equal times; a film of its own fps and seconds has exactly these.

    Raises: InputError: there is no such file. FormatError: it is damaged, of another kind, or of a lens that is no
    pinhole; what it wishes for cannot be filmed.
    """
    return path_of(read_json(Path(path)), str(path))


def path_of(document: object, where: str) -> CameraPath:
    """Return the path of a JSON document, see `read_path`. where: names the document in errors."""
    if isinstance(document, dict) and "camera_path" in document:
        return _checked_path(where, lambda: _of_nerfstudio(document, where))
    if isinstance(document, dict) and "key_frames" in document:
        return _checked_path(where, lambda: _of_ours(document, where))
    raise FormatError(f'{where}: expected a path: an object with "key_frames", or with nerfstudio\'s "camera_path"')


def write_path(path: str | PathLike[str], camera_path: CameraPath, overwrite: bool = False) -> None:
    """Write key frames as JSON that people can read. Raises: InputError: the file exists and not `overwrite`."""
    with replacing(path, overwrite) as file:
        file.write(path_json(camera_path).encode())


def path_json(camera_path: CameraPath) -> str:
    """Return eye, target (a unit ahead) and up of each key frame, in the world; fov from top to bottom."""
    wished = {"seconds": camera_path.seconds, "fps": camera_path.fps, "size": camera_path.size}
    document = {
        "format": KIND,
        "version": VERSION,
        "closed": camera_path.closed,
        "even": camera_path.even,
        **{name: value for name, value in wished.items() if value is not None},
        "key_frames": [_key_json(key) for key in camera_path.keys],
    }
    return json.dumps(document, indent=1) + "\n"


def _key_json(key: KeyFrame) -> dict[str, object]:
    _, down, ahead = key.rotation
    entry: dict[str, object] = {
        "eye": key.eye.tolist(),
        "target": (key.eye + ahead).tolist(),
        "up": (-down).tolist(),
        "fov_degrees": key.fov_degrees,
    }
    return entry if key.seconds is None else entry | {"seconds": key.seconds}


def _checked_path(where: str, read: Callable[[], CameraPath]) -> CameraPath:
    """Read a path, and blame the file for values that no path can be made of."""
    try:
        found = read()
        if found.size is not None:
            check_size(found.size)
        if found.seconds is not None and found.fps is not None:
            frame_count(found.seconds, found.fps)
    except FormatError:
        raise
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error
    return found


def _of_ours(document: Entry, where: str) -> CameraPath:
    if document.get("format") != KIND or document.get("version") != VERSION:
        raise FormatError(
            f'{where}: expected "format": "{KIND}" of version {VERSION}, got {excerpt(document.get("format"))} of '
            f"{excerpt(document.get('version'))}"
        )
    keys = [_key(entry, f"{where}, key frame {i}") for i, entry in enumerate(_entries(document, "key_frames", where))]
    size = document.get("size")
    return CameraPath(
        keys, _flag(document, "closed", where), _flag(document, "even", where),
        _positive(document, "seconds", where), _positive(document, "fps", where),
        None if size is None else _size(as_vector(size, 2, f"{where}: size").tolist(), where),
    )  # fmt: skip


def _key(entry: object, where: str) -> KeyFrame:
    if not isinstance(entry, dict):
        raise FormatError(f"{where}: expected an object, got {excerpt(entry)}")
    eye, target = (_place(entry.get(name), f"{where}: {name}") for name in ("eye", "target"))
    up = _place(entry.get("up"), f"{where}: up")
    fov = as_number(entry.get("fov_degrees", FOV_DEGREES), f"{where}: fov_degrees")
    seconds = as_number(entry["seconds"], f"{where}: seconds") if "seconds" in entry else None
    if not np.linalg.norm(np.cross(target - eye, up)) > 0:
        raise FormatError(f"{where}: expected an up that is not along the line from eye to target, nor zero")
    try:
        view = looking_at(eye, target, up / np.linalg.norm(up), (2, 2), 90.0)
        return KeyFrame(eye, view.cam_from_world[:3, :3], fov, seconds)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _of_nerfstudio(document: Entry, where: str) -> CameraPath:
    lens = document.get("camera_type", "perspective")
    if lens != "perspective":
        raise FormatError(f"{where}: camera_type {excerpt(lens)} is not supported: expected 'perspective'")
    entries = _entries(document, "camera_path", where)
    keys = [_nerfstudio_key(entry, f"{where}, camera {i}") for i, entry in enumerate(entries)]
    sides = [document.get(f"render_{side}") for side in ("width", "height")]
    size = None if sides == [None, None] else _size(sides, where)
    fps = _positive(document, "fps", where)
    seconds = _positive(document, "seconds", where)
    return CameraPath(keys * 2 if len(keys) == 1 else keys, False, True, seconds, fps, size)


def _nerfstudio_key(entry: object, where: str) -> KeyFrame:
    if not isinstance(entry, dict):
        raise FormatError(f"{where}: expected an object, got {excerpt(entry)}")
    numbers = as_vector(entry.get("camera_to_world"), 16, f"{where}: camera_to_world").reshape(4, 4)
    if np.abs(numbers[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise FormatError(
            f"{where}: camera_to_world: expected the last four numbers 0 0 0 1, got {numbers[3].tolist()}"
        )
    rotation = nearest_rotation(numbers[:3, :3], f"{where}: camera_to_world") * _OPENCV_FROM_OPENGL
    eye = _near(numbers[:3, 3], f"{where}: camera_to_world")
    fov = as_number(entry.get("fov", FOV_DEGREES), f"{where}: fov")
    try:
        return KeyFrame(eye, np.ascontiguousarray(rotation.T), fov)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _entries(document: Entry, name: str, where: str) -> list[object]:
    entries = document[name]
    if not isinstance(entries, list) or not 1 <= len(entries) <= MAX_KEYS:
        raise FormatError(f"{where}: expected a list of 1 to {MAX_KEYS:,} {name}, got {excerpt(entries)}")
    return entries


def _place(value: object, where: str) -> np.ndarray:
    return _near(as_vector(value, 3, where), where)


def _near(place: np.ndarray, where: str) -> np.ndarray:
    if not np.abs(place).max() <= MAX_COORDINATE:
        raise FormatError(f"{where}: beyond {MAX_COORDINATE:g}")
    return place


def _flag(document: Entry, name: str, where: str) -> bool:
    value = document.get(name, False)
    if not isinstance(value, bool):
        raise FormatError(f"{where}: {name}: expected true or false, got {excerpt(value)}")
    return value


def _positive(document: Entry, name: str, where: str) -> float | None:
    if document.get(name) is None:
        return None
    number = as_number(document[name], f"{where}: {name}")
    if not number > 0:
        raise FormatError(f"{where}: {name}: expected a number above 0, got {number:g}")
    return number


def _size(sides: Sequence[object], where: str) -> tuple[int, int]:
    width, height = (as_count(side, f"{where}: size") for side in sides)
    return width, height
