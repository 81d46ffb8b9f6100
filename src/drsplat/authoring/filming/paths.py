"""The way of a camera: a smooth curve through key frames, and the views along it.

On disk it is in our own form, or as nerfstudio's camera_path.json.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from ...base.arrays import Array, Doubles, Matrix3, OtherDoubles, Points, Vector3
from ...base.contents import AnyPath, Document
from ...errors import FormatError, InputError
from ...formats.json_files import as_count, as_document, as_fields, as_vector, excerpt, read_json
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

    def at(self, shares: Doubles) -> list[KeyFrame]:
        """Return the cameras at shares of the path's time, from 0 to 1."""
        # the key frames, of a closed path with some of the other end at each end
        count, beyond = len(self.keys), WRAPPED_KEYS if self.closed else 0
        around = [self.keys[number % count] for number in range(-beyond, count + self.closed + beyond)]
        eyes = np.array([key.eye for key in around])
        rotations = Rotation.from_matrix(np.array([key.rotation for key in around]))
        is_timed = self.keys[0].seconds is not None
        if is_timed:
            knots = np.array([key.seconds for key in self.keys], np.float64)
        elif self.even:
            knots = np.arange(len(around), dtype=np.float64)
        else:  # centripetal: set apart by roots of distances
            gaps = np.sqrt(_gaps(eyes, rotations))
            gaps = np.maximum(gaps, MIN_GAP_SHARE * gaps.mean()) if gaps.any() else np.ones(len(gaps))
            knots = np.concatenate([[0], np.cumsum(gaps)])
        curve = CubicHermiteSpline(knots, eyes, _tangents(knots, eyes))
        turning = RotationSpline(knots, rotations)
        lens = PchipInterpolator(knots, [key.fov_degrees for key in around])
        shown, times = knots[beyond : len(knots) - beyond], np.clip(shares, 0, 1)
        if self.even or is_timed:
            places = shown[0] + times * (shown[-1] - shown[0])
        else:  # at one speed
            steps = np.arange((len(shown) - 1) * LENGTH_STEPS + 1) / LENGTH_STEPS
            fine = np.interp(steps, np.arange(len(shown)), shown)
            way = np.concatenate([[0], np.cumsum(_gaps(curve(fine), turning(fine)))])
            places = np.interp(times * way[-1], way, fine)
        parts = zip(curve(places), turning(places).as_matrix(), np.clip(lens(places), *FOV_BOUNDS_DEGREES), strict=True)
        return [KeyFrame(eye, rotation, float(fov)) for eye, rotation, fov in parts]

    def views(self, frames: int, size: tuple[int, int]) -> list[View]:
        """Return a view for each picture of a film; the last of a closed path is the one before the first.

        Raises: InputError: no pictures or too many, or too large ones.
        """
        _check_frames(frames)
        check_size(size)
        shares = np.arange(frames) / max(frames if self.closed else frames - 1, 1)
        return [key.view(size, f"frame_{number:05d}") for number, key in enumerate(self.at(shares))]


def _gaps(eyes: Points, rotations: Rotation) -> OtherDoubles:
    """Return how far each is from the next: moving and turning count alike, in shares of all of each."""
    moved = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    turned = (rotations[:-1].inv() * rotations[1:]).magnitude()
    return sum(part / part.sum() for part in (moved, turned) if part.sum() > 1e-12) + np.zeros(len(moved))


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
    given = document if isinstance(document, dict) else {}
    if not given.keys() & {"camera_path", "key_frames"}:
        raise FormatError(f'{where}: expected a path: an object with "key_frames", or with nerfstudio\'s "camera_path"')
    with _blamed(where):
        path = (_of_nerfstudio if "camera_path" in given else _of_ours)(given, where)
        for name, wished in (("seconds", path.seconds), ("fps", path.fps)):
            if wished is not None and not wished > 0:
                raise InputError(f"{name}: expected a number above 0, got {wished:g}")
        if path.size is not None:
            check_size(path.size)
        if path.seconds is not None and path.fps is not None:
            frame_count(path.seconds, path.fps)
    return path


def write_path(path: AnyPath, camera_path: CameraPath, overwrite: bool = False) -> None:
    """Write key frames as JSON that people can read. Raises: InputError: the file exists and not `overwrite`."""
    with replacing(path, overwrite) as file:
        file.write(path_json(camera_path).encode())


def path_json(camera_path: CameraPath) -> str:
    """Return eye, target (a unit ahead) and up of each key frame, in the world; fov from top to bottom."""
    names = ("closed", "even", "seconds", "fps", "size")
    keys = [
        {
            "eye": key.eye.tolist(),
            "target": (key.eye + key.rotation[2]).tolist(),
            "up": (-key.rotation[1]).tolist(),
            "fov_degrees": key.fov_degrees,
            **_said(key, ("seconds",)),
        }
        for key in camera_path.keys
    ]
    document = {"format": KIND, "version": VERSION, **_said(camera_path, names), "key_frames": keys}
    return json.dumps(document, indent=1) + "\n"


def _said(whole: object, names: Sequence[str]) -> dict[str, object]:
    return {name: value for name in names if (value := getattr(whole, name)) is not None}


@contextmanager
def _blamed(where: str) -> Iterator[None]:
    """Name the part of a file whose values no path can be made of."""
    try:
        yield
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _of_ours(document: Document, where: str) -> CameraPath:
    as_document(document, where, KIND, VERSION)
    wished = as_fields(document, where, closed=bool | None, even=bool | None, seconds=float | None, fps=float | None)
    keys = [_key(entry, f"{where}, key frame {i}") for i, entry in enumerate(_entries(document, "key_frames", where))]
    closed, even, seconds, fps = wished.values()
    size = document.get("size")
    size = None if size is None else _size(as_vector(size, 2, f"{where}: size").tolist(), where)
    return CameraPath(keys, bool(closed), bool(even), seconds, fps, size)


def _key(entry: object, where: str) -> KeyFrame:
    eye, target, up = as_fields(entry, where, eye=Vector3, target=Vector3, up=Vector3).values()
    fov, seconds = as_fields(entry, where, fov_degrees=float | None, seconds=float | None).values()
    _check_near(np.stack([eye, target, up]), where)
    if not np.linalg.norm(np.cross(target - eye, up)) > 0:
        raise FormatError(f"{where}: expected an up that is not along the line from eye to target, nor zero")
    with _blamed(where):
        view = looking_at(eye, target, up / np.linalg.norm(up), (2, 2), 90.0)
        return KeyFrame(eye, view.cam_from_world[:3, :3], FOV_DEGREES if fov is None else fov, seconds)


def _of_nerfstudio(document: Document, where: str) -> CameraPath:
    lens = document.get("camera_type", "perspective")
    if lens != "perspective":
        raise FormatError(f"{where}: camera_type {excerpt(lens)} is not supported: expected 'perspective'")
    entries = _entries(document, "camera_path", where)
    keys = [_nerfstudio_key(entry, f"{where}, camera {i}") for i, entry in enumerate(entries)]
    sides = [document.get(f"render_{side}") for side in ("width", "height")]
    size = None if sides == [None, None] else _size(sides, where)
    seconds, fps = as_fields(document, where, seconds=float | None, fps=float | None).values()
    return CameraPath(keys * 2 if len(keys) == 1 else keys, False, True, seconds, fps, size)


def _nerfstudio_key(entry: object, where: str) -> KeyFrame:
    camera, fov = as_fields(entry, where, camera_to_world=object, fov=float | None).values()
    where = f"{where}: camera_to_world"
    numbers = as_vector(camera, 16, where).reshape(4, 4)
    if np.abs(numbers[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise FormatError(f"{where}: expected the last four numbers 0 0 0 1, got {numbers[3].tolist()}")
    rotation = nearest_rotation(numbers[:3, :3], where) * _OPENCV_FROM_OPENGL
    _check_near(numbers[:3, 3], where)
    with _blamed(where):
        return KeyFrame(numbers[:3, 3], np.ascontiguousarray(rotation.T), FOV_DEGREES if fov is None else fov)


def _entries(document: Document, name: str, where: str) -> list[object]:
    entries = document[name]
    if not isinstance(entries, list) or not 1 <= len(entries) <= MAX_KEYS:
        raise FormatError(f"{where}: expected a list of 1 to {MAX_KEYS:,} {name}, got {excerpt(entries)}")
    return entries


def _check_near(places: Array, where: str) -> None:
    if not np.abs(places).max() <= MAX_COORDINATE:
        raise FormatError(f"{where}: beyond {MAX_COORDINATE:g}")


def _size(sides: Sequence[object], where: str) -> tuple[int, int]:
    width, height = (as_count(side, f"{where}: size") for side in sides)
    return width, height
