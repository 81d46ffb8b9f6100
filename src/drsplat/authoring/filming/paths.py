"""The way of a camera: a smooth curve through key frames, and the views along it.

On disk it is in our own form, or as nerfstudio's camera_path.json.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from ...base.arrays import Array, Doubles, Matrix3, OtherDoubles, Points, Vector3
from ...base.contents import AnyPath
from ...errors import FormatError, InputError
from ...formats.json_files import as_count, as_number, as_vector, excerpt, read_json
from ...formats.poses import MAX_COORDINATE, nearest_rotation
from ...formats.replacing import replacing
from ...scene.views import View
from .looking import FOV_DEGREES, looking_at

MAX_KEYS = 20_000
MAX_FRAMES = 36_000  # ten minutes at 60 a second
MAX_PIXELS, MAX_SIDE_PIXELS = 7680 * 4320, 8192
WRAPPED_KEYS = 4  # key frames repeated from the other end, at each end of a closed curve
LENGTH_STEPS = 24  # between two key frames, to measure the path's length
MIN_GAP_SHARE = 1e-3  # of the mean gap, between key frames at one place
MIN_FPS = 0.01
MAX_FPS = 240.0
FOV_BOUNDS_DEGREES = (1.0, 170.0)


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """A camera that a path passes. rotation: rows are its right, down and ahead in the world.

    fov_degrees: from the top to the bottom of the picture. seconds: when it is passed, None where the way says so.

    Raises: InputError: a lens of less than 1 or more than 170 degrees; what is not finite.
    """

    eye: Vector3
    rotation: Matrix3
    fov_degrees: float
    seconds: float | None = None

    def __post_init__(self) -> None:
        if not FOV_BOUNDS_DEGREES[0] <= self.fov_degrees <= FOV_BOUNDS_DEGREES[1]:
            raise InputError(
                f"fov: expected {FOV_BOUNDS_DEGREES[0]:g} to {FOV_BOUNDS_DEGREES[1]:g} degrees from top to bottom, "
                f"got {self.fov_degrees:g}"
            )
        if not (np.isfinite(self.eye).all() and np.isfinite(self.rotation).all()):
            raise InputError("a key frame needs a finite place and direction")

    @classmethod
    def of(cls, view: View, seconds: float | None = None) -> "KeyFrame":
        """Return the key frame of a view's camera, with the principal point moved to the middle of the picture."""
        fov = np.degrees(2 * np.arctan(view.height / (2 * view.K[1, 1])))
        return cls(view.center, view.cam_from_world[:3, :3], float(np.clip(fov, *FOV_BOUNDS_DEGREES)), seconds)

    def view(self, size: tuple[int, int], name: str = "camera") -> View:
        """Return the view of this key frame. size: pixels across and down."""
        focal = size[1] / (2 * np.tan(np.radians(self.fov_degrees) / 2))
        return View.standing(name, self.eye, self.rotation, focal, size)


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A smooth camera path through key frames.

    Places follow a centripetal Catmull-Rom spline, rotations SciPy's spline on the sphere, lenses do not overshoot.
    closed: the last key frame leads to the first. Key frames with seconds are passed then, with `even` one after the
    other in equal times; else the camera has one speed, in which half of all time goes to moving and half to turning.
    seconds, fps, size: wished for, None for the default.

    Raises: InputError: fewer than two key frames, too many, times that do not rise, or times of a closed path.
    """

    keys: Sequence[KeyFrame]
    closed: bool = False
    even: bool = False
    seconds: float | None = None
    fps: float | None = None
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not 2 <= len(self.keys) <= MAX_KEYS:
            raise InputError(f"a path goes through 2 to {MAX_KEYS:,} key frames, got {len(self.keys):,}")
        given = [key.seconds for key in self.keys if key.seconds is not None]
        if given and (len(given) < len(self.keys) or not (np.diff(given) > 0).all()):
            raise InputError("the seconds of key frames: expected those of all or of none, each later than the last")
        if given and self.closed:
            raise InputError("a closed path has one speed: leave out the seconds of its key frames")

    def __repr__(self) -> str:
        return f"CameraPath({len(self.keys)} key frames{', closed' if self.closed else ''})"

    @property
    def is_timed(self) -> bool:
        return self.keys[0].seconds is not None

    def at(self, shares: Doubles) -> list[KeyFrame]:
        """Return the cameras at shares of the path's time, from 0 to 1."""
        knots = self._knot_at(shares)
        return [
            KeyFrame(eye, rotation, float(np.clip(fov, *FOV_BOUNDS_DEGREES)))
            for eye, rotation, fov in zip(
                self._curve(knots), self._turning(knots).as_matrix(), self._lens(knots), strict=True
            )
        ]

    def views(self, frames: int, size: tuple[int, int]) -> list[View]:
        """Return a view for each picture of a film; the last of a closed path is the one before the first.

        Raises: InputError: no pictures or too many, or too large ones.
        """
        _check_frames(frames)
        check_size(size)
        shares = np.arange(frames) / max(frames if self.closed else frames - 1, 1)
        return [key.view(size, f"frame_{number:05d}") for number, key in enumerate(self.at(shares))]

    # --- the curve, over knots that centripetal distances set apart ---

    @cached_property
    def _around(self) -> list[KeyFrame]:
        """The key frames, of a closed path with some of the other end at each end."""
        if not self.closed:
            return list(self.keys)
        count = len(self.keys)
        return [self.keys[number % count] for number in range(-WRAPPED_KEYS, count + 1 + WRAPPED_KEYS)]

    @property
    def _first(self) -> int:
        return WRAPPED_KEYS if self.closed else 0

    @property
    def _last(self) -> int:
        return self._first + len(self.keys) - (0 if self.closed else 1)

    @cached_property
    def _knots(self) -> Doubles:
        if self.is_timed:
            return np.array([key.seconds for key in self.keys], np.float64)
        if self.even:
            return np.arange(len(self._around), dtype=np.float64)
        gaps = np.sqrt(self._gaps(self._eyes, self._rotations))
        gaps = np.maximum(gaps, MIN_GAP_SHARE * gaps.mean()) if gaps.any() else np.ones(len(gaps))
        return np.concatenate([[0], np.cumsum(gaps)])

    @cached_property
    def _eyes(self) -> Points:
        return np.array([key.eye for key in self._around])

    @cached_property
    def _rotations(self) -> Rotation:
        return Rotation.from_matrix(np.array([key.rotation for key in self._around]))

    @cached_property
    def _curve(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self._knots, self._eyes, _tangents(self._knots, self._eyes))

    @cached_property
    def _turning(self) -> RotationSpline:
        return RotationSpline(self._knots, self._rotations)

    @cached_property
    def _lens(self) -> PchipInterpolator:
        return PchipInterpolator(self._knots, [key.fov_degrees for key in self._around])

    def _gaps(self, eyes: Points, rotations: Rotation) -> OtherDoubles:
        """Return how far each is from the next: moving and turning count alike, in shares of all of each."""
        moved = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
        turned = (rotations[:-1].inv() * rotations[1:]).magnitude()
        return sum(part / part.sum() for part in (moved, turned) if part.sum() > 1e-12) + np.zeros(len(moved))

    def _knot_at(self, shares: Doubles) -> Doubles:
        """Return where on the curve the camera is; `even` and timed paths run as the knots do."""
        shown = self._knots[self._first : self._last + 1]
        if self.even or self.is_timed:
            return shown[0] + np.clip(shares, 0, 1) * (shown[-1] - shown[0])
        steps = np.arange((len(shown) - 1) * LENGTH_STEPS + 1) / LENGTH_STEPS
        fine = np.interp(steps, np.arange(len(shown)), shown)
        way = np.concatenate([[0], np.cumsum(self._gaps(self._curve(fine), self._turning(fine)))])
        return np.interp(np.clip(shares, 0, 1) * way[-1], way, fine)


def _tangents(knots: Doubles, points: Points) -> Points:
    """Return the tangents of a Catmull-Rom spline over uneven knots; it runs straight on at both ends.

    Source: Barry and Goldman 1988; Yuksel et al. 2011 (centripetal knots make no loops).
    """
    gaps = np.diff(knots)[:, None]
    slopes = np.diff(points, axis=0) / gaps
    inner = (slopes[:-1] * gaps[1:] + slopes[1:] * gaps[:-1]) / (gaps[:-1] + gaps[1:])
    return np.concatenate([slopes[:1], inner, slopes[-1:]])


def check_size(size: tuple[int, int]) -> None:
    """Check a film's width and height. Raises: InputError: no pixels, or more than the limit."""
    width, height = size
    if not (2 <= width <= MAX_SIDE_PIXELS and 2 <= height <= MAX_SIDE_PIXELS and width * height <= MAX_PIXELS):
        raise InputError(
            f"size: expected 2x2 to {MAX_SIDE_PIXELS} pixels a side and 7680x4320 in all, got {width}x{height}"
        )


def check_fps(fps: float) -> None:
    """Check the pictures a second of a film. Raises: InputError: fewer or more than films have."""
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InputError(f"fps: expected {MIN_FPS:g} to {MAX_FPS:g} pictures a second, got {fps:g}")


def frame_count(seconds: float, fps: float) -> int:
    """Return how many pictures a film has. Raises: InputError: none, too many, or too slow or fast ones."""
    check_fps(fps)
    if not 0 < seconds <= MAX_FRAMES / MIN_FPS:
        raise InputError(f"seconds: expected above 0, up to {MAX_FRAMES / MIN_FPS:,.0f}; got {seconds:g}")
    count = max(1, round(seconds * fps))
    _check_frames(count)
    return count


def _check_frames(count: int) -> None:
    if not 1 <= count <= MAX_FRAMES:
        raise InputError(f"a film has 1 to {MAX_FRAMES:,} pictures, got {count:,}: fewer seconds or fewer fps")


KIND, VERSION = "drsplat-path", 1
_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])
Entry = Mapping[str, object]


def read_path(path: AnyPath) -> CameraPath:
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


def write_path(path: AnyPath, camera_path: CameraPath, overwrite: bool = False) -> None:
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


def _place(value: object, where: str) -> Array:
    return _near(as_vector(value, 3, where), where)


def _near(place: Array, where: str) -> Array:
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
