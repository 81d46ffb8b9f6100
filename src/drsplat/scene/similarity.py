"""Moving, rotating and scaling Gaussians together with their harmonics."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..base.arrays import Array, Float32, Float64, Harmonics, Matrix3, Matrix4, Points, Quats, Vector3
from ..errors import InputError
from .gaussians import SH_C0, Gaussians, local_origin

MATRIX_TOLERANCE = 1e-4  # matrices come from text with few digits
SH_SLICES = (slice(1, 4), slice(4, 9), slice(9, 16))  # harmonics of degrees 1 to 3
NUM_DIRECTIONS = 64  # to fit harmonics in: several times the coefficients of the highest degree


@dataclass(frozen=True, eq=False)
class Similarity:
    """Similarity transform x -> scale * rotation @ x + translation in the world; see `similarity_of`."""

    scale: float
    rotation: Matrix3
    translation: Vector3

    def positions(self, points: Points) -> Points:
        """Transform points."""
        return self.scale * points @ self.rotation.T + self.translation

    def moved(self, gaussians: Gaussians) -> Gaussians:
        """Return the Gaussians after the transform, in the same rows.

        Colours as seen from a direction turn along: f'(d) = f(rotation^T d).
        """
        positions = self.positions(gaussians.positions)
        origin = local_origin(positions)
        return replace(
            gaussians,
            means=(positions - origin).astype(np.float32),
            quats=turned(gaussians.quats, self.rotation),
            scales=gaussians.scales * np.float32(self.scale),
            sh=self._harmonics(gaussians.sh),
            origin=origin,
        )

    def _harmonics(self, sh: Harmonics) -> Harmonics:
        result = sh.copy()
        for of_degree, matrix in zip(SH_SLICES, self._by_degree, strict=True):
            if of_degree.stop <= sh.shape[1]:
                result[:, of_degree] = np.einsum("ij,njc->nic", matrix, sh[:, of_degree])
        return result

    @cached_property
    def _by_degree(self) -> list[Float32[Array, "k k"]]:
        """Matrix of coefficients for each degree 1 to 3: rotations mix only harmonics of one degree."""
        directions = np.random.default_rng(0).normal(size=(NUM_DIRECTIONS, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        here, there = sh_basis(directions), sh_basis(directions @ self.rotation)
        matrices = [np.linalg.lstsq(here[:, k], there[:, k], rcond=None)[0] for k in SH_SLICES]
        return [matrix.astype(np.float32) for matrix in matrices]


IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))


def similarity_of(matrix: Matrix4) -> Similarity:
    """Split a 4x4 matrix into rotation, uniform scale and translation.

    Raises: InputError: it shears, mirrors, scales its axes differently, or is no such matrix.
    """
    if not np.isfinite(matrix).all() or not np.allclose(matrix[3], [0, 0, 0, 1], atol=MATRIX_TOLERANCE):
        raise InputError("expected a 4x4 matrix of finite numbers whose last row is 0 0 0 1")
    determinant = float(np.linalg.det(matrix[:3, :3]))
    if not determinant > 0:
        raise InputError(f"expected a rotation times a scale above 0: the determinant is {determinant:.3g}")
    scale = determinant ** (1 / 3)
    rotation = matrix[:3, :3] / scale
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > MATRIX_TOLERANCE * 10:
        raise InputError("expected a rotation, one scale and a translation: this matrix shears, or scales axes apart")
    return Similarity(scale, rotation, matrix[:3, 3])


def turned(quats: Quats, rotation: Matrix3) -> Quats:
    """Rotate unit quaternions (w, x, y, z)."""
    a, b = quaternion_of(rotation), quats.astype(np.float64)
    w, v = a[0], a[1:]
    real = w * b[:, :1] - b[:, 1:] @ v[:, None]
    imaginary = w * b[:, 1:] + b[:, :1] * v + np.cross(v, b[:, 1:])
    product = np.concatenate([real, imaginary], axis=1)
    return np.asarray(product / np.linalg.norm(product, axis=1, keepdims=True), np.float32)


def quaternion_of(rotation: Matrix3) -> Float64[Array, " 4"]:
    """Return (w, x, y, z), w >= 0: the eigenvector of Bar-Itzhack's matrix (2000), stable at any angle."""
    m = rotation
    k = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    vector: Array = np.linalg.eigh(k)[1][:, -1]
    return -vector if vector[0] < 0 else vector


def sh_basis(directions: Points) -> Float64[Array, "n 16"]:
    """Evaluate the real spherical harmonics of degrees 0 to 3, in order and sign of 3DGS files."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    columns = [
        np.full_like(x, SH_C0),
        *(0.488602511902920 * c for c in (-y, z, -x)),
        *(1.092548430592079 * c for c in (x * y, -y * z)),
        0.315391565252520 * (2 * zz - xx - yy),
        -1.092548430592079 * x * z,
        0.546274215296040 * (xx - yy),
        -0.590043589926644 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.457045799464466 * y * (4 * zz - xx - yy),
        0.373176332590115 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.457045799464466 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.590043589926644 * x * (xx - 3 * yy),
    ]
    return np.stack(columns, axis=1)
