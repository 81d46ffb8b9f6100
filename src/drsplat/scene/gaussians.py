"""A scene: a set of 3D Gaussians in post-activation form.

Significance: which Gaussians a picture lacks most where there is no room for all.

Place and size of a scene, and the lengths derived from them.

Positions are kept as float32 relative to a local origin in float64, so that a room in the coordinates of a map is as
exact as one about zero. Poses, boxes and whatever else is reported stay in the scene's own coordinates.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..base.arrays import (
    AnyPoints,
    Anywhere,
    Array,
    ArraysByName,
    Bool,
    Doubles,
    Flags,
    Float,
    Float32,
    Float64,
    Harmonics,
    Indices,
    Matrices,
    Numbers,
    Points,
    Quats,
    RowIds,
    Vector3,
    Vectors,
    WholeNumbers,
)
from ..errors import InputError

PUBLISHED_NEAR = 0.2  # scene units: 3DGS draws nothing nearer to a camera
NEAR_SHARE = 0.05  # of the scene's size, where that is less: in scenes smaller than four units
MAX_DISTANCE_SIZES = 2.0  # from zero: beyond, float32 would round positions more coarsely than about zero
MAX_FLOAT32_DISTANCE_SIZES = 256.0  # beyond, float32 rounds to 1e-5 of the scene's size, and arithmetic on it to more
MIN_SIZED_GAUSSIANS = 16  # fewer say nothing of a scene's size
SOLID_OPACITY = 0.1  # fainter Gaussians may float anywhere
MIDDLE_QUANTILES = (0.05, 0.95)


def size_of(positions: AnyPoints) -> float:
    """Return the diagonal of the box about the middle nine tenths along each axis; 0 for no positions."""
    if not len(positions):
        return 0.0
    low, high = np.quantile(positions, MIDDLE_QUANTILES, axis=0)
    return float(np.linalg.norm(high.astype(np.float64) - low.astype(np.float64)))


def middle_of(positions: AnyPoints) -> Vector3:
    """Return the median along each axis, in float64: the sum of two float32 may overflow float32."""
    return np.median(positions.astype(np.float64), axis=0)


def near_plane(means: AnyPoints, opacities: Float[Array, " n"] | None = None) -> float:
    """Return the camera z, in scene units, up to which Gaussians are not drawn.

    It is the published 0.2 for a scene four units large or more (the diagonal of the box about the middle nine tenths
    of its centres, of solid Gaussians where opacities are given); a twentieth of its size for a smaller one.
    """
    solid = means if opacities is None else means[opacities >= SOLID_OPACITY]
    positions = solid if len(solid) >= MIN_SIZED_GAUSSIANS else means
    share = NEAR_SHARE * size_of(positions) if len(positions) >= MIN_SIZED_GAUSSIANS else 0.0
    return min(PUBLISHED_NEAR, share) if share > 0 else PUBLISHED_NEAR


def local_origin(positions: AnyPoints) -> Vector3:
    """Return the point that positions are counted from: zero unless the scene is far from zero along some axis.

    Far is more than twice the scene's size; 256 times where float32 holds all positions as they are, since nothing is
    lost by leaving them there. The origin is near the middle along every axis, and a multiple of a power of two of
    about the scene's size. It is zero along an axis on which float32 holds the positions but not what is left of them,
    so that a scene in float32 has the same positions to the bit before and after.
    """
    origin = np.zeros(3)
    size = size_of(positions)
    if not size > 0 or np.abs(positions).max() <= MAX_DISTANCE_SIZES * size:  # then the middle is, too
        return origin
    middle, exact = middle_of(positions), positions.astype(np.float64)
    exact_axes = _fits_float32(exact)
    if np.abs(middle).max() <= (MAX_FLOAT32_DISTANCE_SIZES if exact_axes.all() else MAX_DISTANCE_SIZES) * size:
        return origin
    step = 2.0 ** np.floor(np.log2(size))
    steps = np.round(middle / step)
    loses = exact_axes & ~_fits_float32(exact - steps * step)
    return np.where(loses | (steps == 0), 0.0, steps * step)


def _fits_float32(positions: Points) -> Bool[Array, " 3"]:
    """Return for each axis whether float32 holds all coordinates exactly."""
    with np.errstate(over="ignore"):
        return (positions.astype(np.float32) == positions).all(0)


def rounding(coordinates: Float[Array, "..."]) -> float:
    """Return the error, in scene units, that float32 may have at the largest of some coordinates."""
    return float(np.spacing(np.float32(np.abs(coordinates).max(initial=0.0))) / 2)


SH_COEFFICIENTS = (1, 4, 9, 16)
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # rows and columns of a covariance's six numbers
SURFEL_THICKNESS = np.float32(1e-6)  # standard deviation of a surfel along its normal, scene units
SH_C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)), the constant harmonic: colour = 0.5 + SH_C0 * sh[:, 0]


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N anisotropic 3D Gaussians. The row order is their identity and is never changed.

    means: positions relative to `origin`, scene units. quats: rotations, (w, x, y, z), unit norm. scales: standard
    deviations along the local axes, scene units, > 0. opacities: in [0, 1]. sh: spherical-harmonic colour coefficients,
    degree 0-3 (1, 4, 9 or 16 per channel), RGB last. extra: further per-Gaussian columns of the file it came from, by
    name, each of length N. origin: in the coordinates of the world, which are those of views and answers; zero unless
    the scene is far from zero for its size (`placing.local_origin`). antialiased: opacities are of Gaussians as they
    are; a picture widens them, and dims them as it does (method.md 1; "mip" in other programs).

    Raises: InputError: shapes disagree, or an origin that is not finite.
    """

    means: Vectors
    quats: Quats
    scales: Vectors
    opacities: Numbers
    sh: Harmonics
    extra: ArraysByName = field(default_factory=dict)
    origin: Vector3 = field(default_factory=lambda: np.zeros(3))
    antialiased: bool = False

    def __post_init__(self) -> None:
        n = len(self.means)
        if self.origin.shape != (3,) or not np.isfinite(self.origin).all():
            raise InputError(f"origin: expected three finite numbers, got {self.origin}")
        expected = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != np.float32:
                raise InputError(f"{name}: expected float32 {shape}, got {array.dtype} {array.shape}")
        k = self.sh.shape[1] if self.sh.ndim == 3 else -1
        if self.sh.shape != (n, k, 3) or k not in SH_COEFFICIENTS or self.sh.dtype != np.float32:
            raise InputError(f"sh: expected float32 ({n}, 1|4|9|16, 3), got {self.sh.dtype} {self.sh.shape}")
        for name, column in self.extra.items():
            if len(column) != n:
                raise InputError(f"extra column '{name}': expected {n} values, got {len(column)}")

    def __repr__(self) -> str:
        return f"Gaussians({len(self):,}, harmonics of degree {self.sh_degree}, {self.fingerprint})"

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        return SH_COEFFICIENTS.index(self.sh.shape[1])

    @cached_property
    def surfels(self) -> bool:
        """True for flat discs, as 2DGS trains them: each as thick as what is read for no thickness."""
        return bool(len(self)) and bool((self.scales[:, 2] == SURFEL_THICKNESS).all())

    def flattened(self) -> "Gaussians":
        """Return the Gaussians as surfels: the normal is the third axis."""
        return replace(self, scales=flat(self.scales[:, :2]))

    @cached_property
    def fingerprint(self) -> str:
        """Count and position hash: equal for the same Gaussians in the same order, whatever the file.

        It hashes positions in the world, so it does not depend on the origin. Antialiased scenes have another
        fingerprint than others with the same positions, because their Gaussians weigh otherwise.
        """
        digest = hashlib.blake2b(np.ascontiguousarray(self.narrow_positions).tobytes(), digest_size=12)
        digest.update(drawing_mark(self.antialiased))
        return f"{len(self)}-{digest.hexdigest()}"

    @property
    def positions(self) -> Points:
        """Positions in world coordinates: `means` plus `origin`."""
        return self.means.astype(np.float64) + self.origin

    @property
    def narrow_positions(self) -> Vectors | Points:
        """Positions in world coordinates: float32 where that is exact, else float64."""
        if not self.origin.any():
            return self.means
        positions = self.positions
        narrow = positions.astype(np.float32)
        return narrow if (narrow == positions).all() else positions

    @cached_property
    def near(self) -> float:
        """Camera z up to which nothing is drawn; see `placing.near_plane`."""
        return near_plane(self.means, self.opacities)

    def localized(self) -> "Gaussians":
        """Return the Gaussians counted from a local origin; the same object if they need no other.

        Float32 arithmetic on them is then as exact as about zero; what float32 positions have lost stays lost.
        """
        by = self._local_origin
        if not by.any():
            return self
        means = (self.means.astype(np.float64) - by).astype(np.float32)
        return replace(self, means=means, origin=self.origin + by)

    @cached_property
    def _local_origin(self) -> Vector3:
        return local_origin(self.means) if len(self) >= MIN_SIZED_GAUSSIANS else np.zeros(3)

    def covariances(self) -> Float64[Array, "n 6"]:
        """Return the upper triangles (xx, xy, xz, yy, yz, zz) of R S S^T R^T, in scene units squared."""
        return covariances_of(self.quats, self.scales).T

    def whitening(self) -> Matrices:
        """Return inv(S) R^T, which maps offsets from the mean to a space where the Gaussian is a unit sphere."""
        inverse = self.quats.astype(np.float64) * [1, -1, -1, -1]
        return rotation_matrices(inverse) / self.scales.astype(np.float64)[:, :, None]

    def subset(self, index: RowIds | Flags) -> "Gaussians":
        """Return the Gaussians at `index` (integers or a boolean mask), in that order."""
        extra = {name: column[index] for name, column in self.extra.items()}
        return Gaussians(
            self.means[index], self.quats[index], self.scales[index], self.opacities[index], self.sh[index], extra,
            self.origin, self.antialiased,
        )  # fmt: skip

    def shapes_of(self, index: RowIds) -> "Gaussians":
        """Return the Gaussians at some rows without their colours, in that order; `Parted` has the same method."""
        black = np.zeros((len(index), 1, 3), np.float32)
        return Gaussians(
            self.means[index], self.quats[index], self.scales[index], self.opacities[index], black,
            origin=self.origin, antialiased=self.antialiased,
        )  # fmt: skip

    def opacities_of(self, index: WholeNumbers) -> Numbers:
        """Return the opacities of some rows; `Parted` has the same method."""
        return self.opacities[index]

    def parts_near(self, point: Vector3 | None = None) -> "Iterator[Part]":
        """Yield all Gaussians as one part; `Parted` has the same method."""
        yield Part(0, 0.0, self)


class Part(NamedTuple):
    """A run of a scene's rows.

    first: its first row. away2: squared distance from the point that was asked for, at least; 0 where there was none.
    """

    first: int
    away2: float
    gaussians: Gaussians


def covariances_of(quats: Quats, scales: Vectors) -> Float64[Array, "6 n"]:
    """Compute `Gaussians.covariances` one component at a time, so that a block stays in the processor's cache."""
    turned = rotation_rows(quats.T.astype(np.float64, order="C"))
    lengths = scales.T.astype(np.float64, order="C")
    axes = [[number * length for number, length in zip(row, lengths, strict=True)] for row in turned]
    covariances = np.empty((6, len(quats)))
    for at, (i, j) in enumerate(UPPER):
        covariances[at] = axes[i][0] * axes[j][0] + axes[i][1] * axes[j][1] + axes[i][2] * axes[j][2]
    return covariances


def flat(widths: Float32[Array, "n 2"]) -> Vectors:
    """Return the standard deviations of surfels from those along their two axes."""
    return np.column_stack([widths, np.full(len(widths), SURFEL_THICKNESS)])


class ShapesDigest:
    """Hash of all positions and shapes, however the rows are split into parts; all parts share one origin."""

    def __init__(self, origin: Vector3) -> None:
        self._origin, self._mark = origin, b""
        self._hashes = {name: hashlib.blake2b(digest_size=16) for name in ("means", "quats", "scales", "opacities")}

    def add(self, part: Gaussians) -> "ShapesDigest":
        for name, digest in self._hashes.items():
            digest.update(np.ascontiguousarray(getattr(part, name)).data)
        self._mark = drawing_mark(part.antialiased)
        return self

    def text(self) -> str:
        whole = b"".join(digest.digest() for digest in self._hashes.values()) + self._origin.tobytes() + self._mark
        return hashlib.blake2b(whole, digest_size=16).hexdigest()


def concatenated(parts: Sequence[Gaussians]) -> Gaussians:
    """Concatenate Gaussians in the order given, counted from one origin; missing harmonics are zero.

    Extra columns stay where all parts have them.

    Raises: InputError: some are drawn antialiased and others are not.
    """
    positions = np.concatenate([part.positions for part in parts])
    origin = local_origin(positions)
    most = max(part.sh.shape[1] for part in parts)
    return Gaussians(
        (positions - origin).astype(np.float32),
        np.concatenate([part.quats for part in parts]),
        np.concatenate([part.scales for part in parts]),
        np.concatenate([part.opacities for part in parts]),
        np.concatenate([filled(part.sh, most) for part in parts]),
        {
            name: np.concatenate([p.extra[name] for p in parts])
            for name in parts[0].extra
            if all(name in p.extra for p in parts)
        },
        origin,
        drawn_alike([part.antialiased for part in parts]),
    )


def drawn_alike(antialiased: Sequence[bool]) -> bool:
    """Return whether all parts are drawn antialiased. Raises: InputError: some are and others are not."""
    if len(set(antialiased)) > 1:
        raise InputError(
            f"{sum(antialiased)} of {len(antialiased)} parts are drawn antialiased (mip) and the others are not: the "
            "same opacity is of another picture there, and one scene is drawn in one way. Train the parts alike"
        )
    return any(antialiased)


def drawing_mark(antialiased: bool) -> bytes:
    """Return the bytes to hash for the way of drawing; none if not antialiased, which keeps older hashes."""
    return b"antialiased" if antialiased else b""


def filled(sh: Harmonics, coefficients: int) -> Float32[Array, "n c 3"]:
    """Pad harmonics with zeros up to a number of coefficients."""
    return np.pad(sh, ((0, 0), (0, coefficients - sh.shape[1]), (0, 0)))


def rotation_matrices(quats: Float[Array, "n 4"]) -> Float[Array, "n 3 3"]:
    """Return the matrices from local axes (their columns) to the world, in the precision of the input."""
    return np.stack([np.stack(row, -1) for row in rotation_rows(quats.T)], -2)


def rotation_rows(quats: Float[Anywhere, "4 n"]) -> list[list[Float[Anywhere, " n"]]]:
    """Return the entries of `rotation_matrices` as three rows of three arrays, each over all quaternions."""
    w, x, y, z = quats
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


VOLUME_POWER = 0.1


def significance(gaussians: Gaussians) -> Doubles:
    """Return the opacity of each Gaussian times its volume to the power 0.1: how much a picture lacks without it.

    Source: Fan et al. 2023 (LightGaussian) Eq. 2, without its count of rays: it needs no photos.
    """
    return gaussians.opacities * gaussians.scales.astype(np.float64).prod(1) ** VOLUME_POWER


def most_significant(gaussians: Gaussians, budget: int) -> Indices:
    """Return the ascending ids of the `budget` Gaussians of the largest `significance`."""
    if len(gaussians) <= budget:
        return np.arange(len(gaussians))
    return np.sort(np.argpartition(-significance(gaussians), budget - 1)[:budget])
