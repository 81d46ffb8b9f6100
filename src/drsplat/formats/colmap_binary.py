"""COLMAP's cameras.bin, images.bin and points3D.bin, read record by record, and written.

Little-endian, no padding; images and points have records of variable length.

Records of a COLMAP model, whether in text or in binary.

Source: https://colmap.github.io/format.html and COLMAP's list of camera models.
"""

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Colors, Points
from ..base.contents import file_bytes
from ..errors import FormatError, InputError
from ..scene.views import View
from .poses import cure_of
from .replacing import replacing

PointRecord = tuple[float, float, float, int, int, int]
"""x, y, z (world), r, g, b."""

MODEL_NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
    "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR",
)  # fmt: skip
"""By COLMAP's model id."""

PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy"), "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"), "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}  # fmt: skip
"""Parameters of the camera models that a remap to a pinhole can undo."""


class CameraRecord(NamedTuple):
    camera_id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


class ImageRecord(NamedTuple):
    """quaternion (w, x, y, z) and translation take world to camera."""

    name: str
    quaternion: tuple[float, float, float, float]
    translation: tuple[float, float, float]
    camera_id: int


def parameter_names(model: str, where: str) -> tuple[str, ...]:
    """Return the order of a model's parameters in the file.

    Raises: FormatError: a lens that no pinhole stands for; the message says what to run.
    """
    if model in PARAMETERS:
        return PARAMETERS[model]
    raise FormatError(
        f"{where}: camera model {model!a} is not supported (supported: {', '.join(PARAMETERS)}): {cure_of(model)}"
    )


_PINHOLE = MODEL_NAMES.index("PINHOLE")
Lens = tuple[int, int, float, float, float, float]


COUNT = struct.Struct("<Q")
CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; then the model's parameters
IMAGE = struct.Struct("<I7dI")  # id, quaternion, translation, camera id; then name, count, 2D points
POINT = struct.Struct("<Q3d3BdQ")  # id, xyz, rgb, error, length of the track; then the track
_OBSERVATION_BYTES = 24
_TRACK_BYTES = 8
_MAX_NAME_BYTES = 4096


class _Cursor:
    """A position in a file that never leaves it."""

    def __init__(self, path: Path) -> None:
        self.path, self._content, self._at = path, file_bytes(path).data, 0

    def take(self, layout: struct.Struct) -> tuple[Any, ...]:
        start = self._at
        self.skip(layout.size)
        return layout.unpack_from(self._content, start)

    def count(self, record_bytes: int) -> int:
        """Read a count of records, each at least `record_bytes` long, that can still follow."""
        (count,) = self.take(COUNT)
        left = len(self._content) - self._at
        if count * record_bytes > left:
            raise FormatError(
                f"{self.path}: claims {count} records of {record_bytes} bytes or more, has {left} bytes left"
            )
        return int(count)

    def name(self) -> str:
        raw, end, _ = bytes(self._content[self._at : self._at + _MAX_NAME_BYTES]).partition(b"\0")
        if not end:
            raise FormatError(f"{self.path}: an image name at byte {self._at} does not end")
        self._at += len(raw) + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise FormatError(f"{self.path}: an image name is not UTF-8: {error}") from error

    def skip(self, num_bytes: int) -> None:
        if self._at + num_bytes > len(self._content):
            raise FormatError(
                f"{self.path}: truncated: {num_bytes} bytes expected at byte {self._at} of {len(self._content)}"
            )
        self._at += num_bytes

    def finish(self) -> None:
        left = len(self._content) - self._at
        if left:
            raise FormatError(
                f"{self.path}: {left} bytes follow the last record: damaged or of an unknown COLMAP version"
            )


def cameras(path: Path) -> Iterator[CameraRecord]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(CAMERA.size)):
        camera_id, model_id, width, height = map(int, cursor.take(CAMERA))
        model = MODEL_NAMES[model_id] if 0 <= model_id < len(MODEL_NAMES) else f"id {model_id}"
        num_parameters = len(parameter_names(model, f"{path}, camera {camera_id}"))
        parameters = cursor.take(struct.Struct(f"<{num_parameters}d"))
        yield CameraRecord(camera_id, model, width, height, parameters)
    cursor.finish()


def images(path: Path) -> Iterator[ImageRecord]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(IMAGE.size + 1 + COUNT.size)):
        _, w, x, y, z, tx, ty, tz, camera_id = cursor.take(IMAGE)
        name = cursor.name()
        cursor.skip(cursor.count(_OBSERVATION_BYTES) * _OBSERVATION_BYTES)
        yield ImageRecord(name, (w, x, y, z), (tx, ty, tz), int(camera_id))
    cursor.finish()


def points(path: Path) -> Iterator[PointRecord]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(POINT.size)):
        _, x, y, z, r, g, b, _, track = cursor.take(POINT)
        cursor.skip(int(track) * _TRACK_BYTES)
        yield x, y, z, int(r), int(g), int(b)
    cursor.finish()


def write_colmap(model: Path, views: Sequence[View], positions: Points, colors: Colors) -> None:
    """Write cameras.bin, images.bin and points3D.bin into a folder that is there.

    Views of one lens share a camera. Points have no tracks. A pose is written as a quaternion: what `read_colmap` reads
    may differ from it in the last digits, and is the same at every reading.

    Raises: InputError: a lens with distortion; files that are there already; the disk is full.
    """
    lenses = [_lens(view) for view in views]
    numbers = {lens: number for number, lens in enumerate(dict.fromkeys(lenses), 1)}
    with replacing(model / "cameras.bin") as file:
        file.write(COUNT.pack(len(numbers)))
        for (width, height, *parameters), number in numbers.items():
            file.write(CAMERA.pack(number, _PINHOLE, width, height) + np.array(parameters, "<f8").tobytes())
    with replacing(model / "images.bin") as file:
        file.write(COUNT.pack(len(views)))
        for number, (view, lens) in enumerate(zip(views, lenses, strict=True), 1):
            placed = (*_quaternion(view), *view.cam_from_world[:3, 3].tolist())
            file.write(IMAGE.pack(number, *placed, numbers[lens]) + view.name.encode() + b"\0" + COUNT.pack(0))
    with replacing(model / "points3D.bin") as file:
        file.write(COUNT.pack(len(positions)))
        for number, (place, color) in enumerate(zip(positions.tolist(), colors.tolist(), strict=True), 1):
            file.write(POINT.pack(number, *place, *color, 0.0, 0))  # no reprojection error, no track


def _lens(view: View) -> Lens:
    if view.distortion is not None:
        raise InputError(f"view '{view.name}' has a distortion: only pinholes are written")
    K = view.K
    return view.width, view.height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def _quaternion(view: View) -> list[float]:
    """Return the rotation as w, x, y, z with w >= 0."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat(canonical=True).tolist()
    return [w, x, y, z]
