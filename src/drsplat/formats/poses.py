"""Poses: entries of camera files become Views, with errors that name the entry."""

import math

import numpy as np

from ..base.arrays import Float64
from ..errors import FormatError, InputError
from ..scene.gaussians import rotation_matrices
from ..scene.views import View

Matrix3 = Float64[np.ndarray, "3 3"]
Matrix4 = Float64[np.ndarray, "4 4"]
Vector3 = Float64[np.ndarray, "3"]

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
    return np.asarray(rotation_matrices(unit)[0])


def nearest_rotation(matrix: Matrix3, where: str) -> Matrix3:
    """Return the rotation that a 3x3 written with few digits stands for.

    Raises: FormatError: the matrix scales, shears or mirrors by more than rounding.
    """
    lengths = [math.hypot(*column) for column in matrix.T]
    if max(abs(length - 1) for length in lengths) < RIGID_TOLERANCE:
        u, stretch, vt = np.linalg.svd(matrix)
        if np.abs(stretch - 1).max() < RIGID_TOLERANCE and np.linalg.det(matrix) > 0:
            rotation: Matrix3 = u @ vt
            return rotation
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
