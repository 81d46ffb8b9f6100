"""Arrays that the kernels draw a scene from, and what they return, the same on the CPU and on a GPU."""

import os
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import (
    Anywhere,
    Flags,
    Float32,
    Ids,
    Int32,
    Numbers,
    PixelNumbers,
    PixelRows,
    RowIds,
    UnsignedIds,
    Vector3,
)
from ..errors import InputError
from ..scene.gaussians import PUBLISHED_NEAR, Gaussians, covariances_of
from ..scene.views import View

BLOCK_GAUSSIANS = 1 << 13  # whose covariances are computed at once
MAX_SIDE_PIXELS = 65536
MAX_COUNT = 2**31 - 1  # that the kernels take; no ray meets as many Gaussians


class SplatArrays(NamedTuple):
    """Structure of arrays that the kernels draw a scene from; make it once, use it for all views.

    means: relative to origin. near: camera z up to which nothing is drawn. antialiased: see `Gaussians`. engine: the
    GPU whose arrays they are (`cuda.engine.Engine`), None on the CPU.
    """

    means: Float32[Anywhere, "3 n"]
    covariances: Float32[Anywhere, "6 n"]  # xx, xy, xz, yy, yz, zz
    opacities: Float32[Anywhere, " n"]
    near: float = PUBLISHED_NEAR
    origin: Vector3 = np.zeros(3)
    antialiased: bool = False
    engine: Any = None

    def subset(self, index: RowIds | Flags) -> "SplatArrays":
        """Return the arrays of the Gaussians at `index`; the near plane stays that of the whole scene."""
        xp = np if self.engine is None else self.engine.xp
        rows = xp.asarray(index)
        means, covariances, opacities = (
            xp.ascontiguousarray(array[..., rows]) for array in (self.means, self.covariances, self.opacities)
        )
        return self._replace(means=means, covariances=covariances, opacities=opacities)


class Triples(NamedTuple):
    """Non-zero entries of one view's columns of W, sorted by (Gaussian, mask); weights > 0."""

    gaussian_ids: UnsignedIds
    mask_ids: Ids
    weights: Numbers


class Contributions(NamedTuple):
    """The largest blending weights of each pixel, descending; padded with id -1, weight 0."""

    ids: Int32[np.ndarray, "h w c"]
    weights: PixelRows


class Rendering(NamedTuple):
    """An image of per-Gaussian values.

    channels: sum of weight * value. depth: weighted mean of camera z, 0 where nothing is.
    """

    channels: PixelRows
    alpha: PixelNumbers
    depth: PixelNumbers


def available_isas() -> list[str]:
    """Return the instruction sets of this build that this machine runs, best first."""
    return list(_native.available_isas())


def compiler() -> str:
    """Return the name and version of the compiler of this build."""
    return _native.compiler


def default_isa() -> str:
    """Return the instruction set used when none is named: that of DRSPLAT_ISA, else the best.

    Raises: InputError: DRSPLAT_ISA names one that is not available.
    """
    try:
        return _native.default_isa()
    except ValueError:
        isa = os.environ.get("DRSPLAT_ISA")
        raise InputError(f"DRSPLAT_ISA asks for '{isa}'; this machine and build have {available_isas()}") from None


def splat_arrays_at_origin(gaussians: Gaussians, near: float) -> SplatArrays:
    """Lay the scene out for the kernels, keeping its origin. Raises: InputError: see `splat_arrays`."""
    if not 0 < near < np.inf:
        raise InputError(f"near: expected a distance in front of the camera, got {near}")
    covariances = np.empty((6, len(gaussians)), np.float32)
    for begin in range(0, len(gaussians), BLOCK_GAUSSIANS):
        part = slice(begin, begin + BLOCK_GAUSSIANS)
        with np.errstate(over="ignore"):  # infinite ones are drawn nowhere
            covariances[:, part] = covariances_of(gaussians.quats[part], gaussians.scales[part])
    means = np.ascontiguousarray(gaussians.means.T)
    opacities = np.ascontiguousarray(gaussians.opacities)
    return SplatArrays(means, covariances, opacities, near, gaussians.origin, gaussians.antialiased)


def camera_numbers(view: View, near: float) -> Float32[np.ndarray, "17"]:
    """Return a camera as the kernels take it: rotation, translation, fx, fy, cx, cy, near.

    Raises: InputError: too large a raster, or skew.
    """
    if max(view.size) > MAX_SIDE_PIXELS:
        raise InputError(
            f"view '{view.name}' is {view.width}x{view.height}; at most {MAX_SIDE_PIXELS} pixels a side: resize it"
        )
    if abs(view.K[0, 1]) > 1e-6 * view.K[0, 0]:
        raise InputError(f"view '{view.name}' has skew {view.K[0, 1]}: only cameras without skew are supported")
    pose, K = view.cam_from_world, view.K
    numbers = [*pose[:3, :3].ravel(), *pose[:3, 3], K[0, 0], K[1, 1], K[0, 2], K[1, 2], near]
    return np.array(numbers, np.float32)


def native(what: str, kernel: Callable[..., Any], *given: object, got: str = "") -> tuple[np.ndarray, ...]:
    """Call a kernel with contiguous arrays, and return its arrays.

    Args:
        what: names the call in errors.
        kernel: a function of the native core.
        given: its arguments; arrays are made contiguous, also those in tuples.
        got: ends the error, and says what was given.

    Raises: InputError: arrays that do not fit each other, as the kernel says.
    """
    try:
        made = kernel(*map(_contiguous, given))
    except (ValueError, TypeError) as error:
        raise InputError(f"{what}: expected {str(error).splitlines()[0]}{got}") from None
    return tuple(map(np.asarray, made if isinstance(made, tuple | list) else (made,)))


def native_array(what: str, kernel: Callable[..., Any], *given: object, got: str = "") -> np.ndarray:
    """Call a kernel that makes one array, and return it; see `native`."""
    return native(what, kernel, *given, got=got)[0]


def _contiguous(given: Any) -> Any:
    if isinstance(given, tuple):
        return tuple(map(_contiguous, given))
    return np.ascontiguousarray(given) if isinstance(given, np.ndarray) else given


def checked_isa(isa: str) -> str:
    if not isa:
        return default_isa()
    if isa not in available_isas():
        raise InputError(f"instruction set '{isa}' is not available; this machine and build have {available_isas()}")
    return isa
