"""Views and points -> a COLMAP sparse model in binary, which COLMAP itself and trainers read.

Source: https://colmap.github.io/format.html
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..base.arrays import Float64, UInt8
from ..errors import InputError
from ..scene.views import View
from .colmap_binary import CAMERA, COUNT, IMAGE, POINT
from .colmap_records import MODEL_NAMES
from .replacing import replacing

_PINHOLE = MODEL_NAMES.index("PINHOLE")
Lens = tuple[int, int, float, float, float, float]


def write_colmap(
    model: Path, views: Sequence[View], positions: Float64[np.ndarray, "n 3"], colors: UInt8[np.ndarray, "n 3"]
) -> None:
    """Write cameras.bin, images.bin and points3D.bin into a folder that is there.

    Views of one lens share a camera. Points have no tracks. A pose is written as a quaternion: what `read_colmap` reads
    may differ from it in the last digits, and is the same at every reading.

    Raises: InputError: a lens with distortion; files that are there already; the disk is full.
    """
    lenses = [_lens(view) for view in views]
    numbers = {lens: number for number, lens in enumerate(dict.fromkeys(lenses), 1)}
    with replacing(model / "cameras.bin") as file:
        _count(file, len(numbers))
        for (width, height, *parameters), number in numbers.items():
            file.write(CAMERA.pack(number, _PINHOLE, width, height) + np.array(parameters, "<f8").tobytes())
    with replacing(model / "images.bin") as file:
        _count(file, len(views))
        for number, (view, lens) in enumerate(zip(views, lenses, strict=True), 1):
            placed = (*_quaternion(view), *view.cam_from_world[:3, 3].tolist())
            file.write(IMAGE.pack(number, *placed, numbers[lens]) + view.name.encode() + b"\0" + COUNT.pack(0))
    with replacing(model / "points3D.bin") as file:
        _count(file, len(positions))
        file.writelines(_points(positions.tolist(), colors.tolist()))


def _count(file: BinaryIO, count: int) -> None:
    file.write(COUNT.pack(count))


def _points(positions: Iterable[list[float]], colors: Iterable[list[int]]) -> Iterable[bytes]:
    """Return each point's record: no reprojection error, no track."""
    return (
        POINT.pack(number, *place, *color, 0.0, 0)
        for number, (place, color) in enumerate(zip(positions, colors, strict=True), 1)
    )


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
