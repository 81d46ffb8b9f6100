"""Blending weights of Gaussians in a view, and images made from them (native; float32).

Semantics are those of 3D Gaussian Splatting: see docs/method.md, "Blending weights". Every function is
the same to the bit for any number of threads. `threads=0` takes all cores; `isa` names an instruction
set of `available_isas()`, "" the best (or what the variable DRSPLAT_ISA names).
"""

import os
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import Anywhere, Bool, Float32, Float64, Int32, Integer, UInt32
from ..errors import InputError
from ..scene.gaussians import Gaussians, covariances_of
from ..scene.placing import PUBLISHED_NEAR
from ..scene.views import View
from .cuda.devices import engine_in_use

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
    origin: Float64[np.ndarray, " 3"] = np.zeros(3)
    antialiased: bool = False
    engine: Any = None

    def subset(self, index: Integer[np.ndarray, " m"] | Bool[np.ndarray, " n"]) -> "SplatArrays":
        """Return the arrays of the Gaussians at `index`; the near plane stays that of the whole scene."""
        xp = np if self.engine is None else self.engine.xp
        rows = xp.asarray(index)
        means, covariances, opacities = (
            xp.ascontiguousarray(array[..., rows]) for array in (self.means, self.covariances, self.opacities)
        )
        return self._replace(means=means, covariances=covariances, opacities=opacities)


class Triples(NamedTuple):
    """Non-zero entries of one view's columns of W, sorted by (Gaussian, mask); weights > 0."""

    gaussian_ids: UInt32[np.ndarray, " t"]
    mask_ids: Int32[np.ndarray, " t"]
    weights: Float32[np.ndarray, " t"]


class Contributions(NamedTuple):
    """The largest blending weights of each pixel, descending; padded with id -1, weight 0."""

    ids: Int32[np.ndarray, "h w k"]
    weights: Float32[np.ndarray, "h w k"]


class Rendering(NamedTuple):
    """An image of per-Gaussian values.

    channels: sum of weight * value. depth: weighted mean of camera z, 0 where nothing is.
    """

    channels: Float32[np.ndarray, "h w c"]
    alpha: Float32[np.ndarray, "h w"]
    depth: Float32[np.ndarray, "h w"]


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


def splat_arrays(gaussians: Gaussians, near: float | None = None) -> SplatArrays:
    """Lay the scene out for the kernels, on the device in use (`using_device`): 40 bytes per Gaussian.

    near: camera z up to which nothing is drawn, scene units; None: `gaussians.near`.

    Raises: InputError: a near plane that is not in front of the camera.
    """
    arrays = splat_arrays_at_origin(gaussians.localized(), gaussians.near if near is None else near)
    return on_device_in_use(arrays)


def on_device_in_use(splats: SplatArrays) -> SplatArrays:
    """Return a scene's arrays on the device in use, copied there if they are the host's."""
    engine = engine_in_use()
    if engine is None or splats.engine is not None:
        return splats
    sent: SplatArrays = _on_device().sent_splats(engine, splats)
    return sent


def _on_device() -> Any:
    """Return the module that draws on a GPU; it needs this one."""
    return import_module(".cuda.drawing", __package__)


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


def _scene_and_camera(splats: SplatArrays, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool, np.ndarray]:
    """Return means, covariances, opacities, whether they are drawn antialiased, and the camera."""
    return (
        splats.means,
        splats.covariances,
        splats.opacities,
        splats.antialiased,
        camera_numbers(view.relative_to(splats.origin), splats.near),
    )


def camera_numbers(view: View, near: float) -> Float32[np.ndarray, "17"]:
    """Return a camera as the kernels take it: rotation, translation, fx, fy, cx, cy, near.

    Raises: InputError: too large a raster, or skew.
    """
    if max(view.width, view.height) > MAX_SIDE_PIXELS:
        raise InputError(
            f"view '{view.name}' is {view.width}x{view.height}; at most {MAX_SIDE_PIXELS} pixels a side: resize it"
        )
    if abs(view.K[0, 1]) > 1e-6 * view.K[0, 0]:
        raise InputError(f"view '{view.name}' has skew {view.K[0, 1]}: only cameras without skew are supported")
    pose, K = view.cam_from_world, view.K
    numbers = [*pose[:3, :3].ravel(), *pose[:3, 3], K[0, 0], K[1, 1], K[0, 2], K[1, 2], near]
    return np.array(numbers, np.float32)


def checked_isa(isa: str) -> str:
    if not isa:
        return default_isa()
    if isa not in available_isas():
        raise InputError(f"instruction set '{isa}' is not available; this machine and build have {available_isas()}")
    return isa


def _positive(name: str, value: int | None) -> int:
    if value is not None and value < 1:
        raise InputError(f"{name}: expected a positive integer, or None for all; got {value}")
    return min(value or 0, MAX_COUNT)


def view_weights(
    splats: SplatArrays,
    view: View,
    mask_ids: Int32[np.ndarray, "h w"],
    topk: int | None = 40,
    *,
    first_hits: int | None = None,
    threads: int = 0,
    isa: str = "",
) -> Triples:
    """Return W's entries for one view: per (Gaussian, mask), the sum of its top-k weights there.

    Pixels with mask -1 contribute nothing. topk None keeps every contributor. first_hits=100 keeps
    only the first hundred of each ray before the top k are taken, as the published code does.

    Raises: InputError: topk or first_hits < 1; a mask map of another size than the view.
    Source: Dr. Splat Sec. A "Training stage"; 3DGS Eq. 3.
    """
    if mask_ids.shape != (view.height, view.width):
        raise InputError(
            f"view '{view.name}': mask map is {mask_ids.shape[1]}x{mask_ids.shape[0]}, "
            f"the view {view.width}x{view.height}: resize one of them"
        )
    pixels = np.ascontiguousarray(mask_ids, np.int32)
    limits = _positive("topk", topk), _positive("first_hits", first_hits)
    splats = on_device_in_use(splats)
    if splats.engine is not None:
        there: Triples = _on_device().view_weights(splats, view, pixels, *limits)
        return there
    triples = _native.view_weights(*_scene_and_camera(splats, view), pixels, *limits, threads, checked_isa(isa))
    return Triples(*triples[:3])


def topk_contributions(
    splats: SplatArrays, view: View, k: int, *, first_hits: int | None = None, threads: int = 0, isa: str = ""
) -> Contributions:
    """Return the k largest blending weights of each pixel and the Gaussians that own them.

    Descending in weight; ties front to back. 8k bytes per pixel.

    Raises: InputError: k < 1.
    Source: Dr. Splat Sec. A; 3DGS Eq. 3.
    """
    size, limits = (view.width, view.height), (_positive("k", k), _positive("first_hits", first_hits))
    splats = on_device_in_use(splats)
    if splats.engine is not None:
        there: Contributions = _on_device().topk_contributions(splats, view, *limits)
        return there
    arrays = _scene_and_camera(splats, view)
    return Contributions(*_native.topk_contributions(*arrays, *size, *limits, threads, checked_isa(isa)))


def heaviest_labels(
    seen: Contributions, labels: Int32[np.ndarray, " n"], *, threads: int = 0
) -> Int32[np.ndarray, "h w"]:
    """Return the label with the most weight in each pixel, -1 for none; ties go to the heaviest Gaussian's.

    seen: the eight largest weights of each pixel. labels: one per Gaussian.

    Raises: InputError: another number of weights, or Gaussians without a label.
    """
    ids, weights = map(np.ascontiguousarray, seen)
    try:
        return np.asarray(_native.heaviest_labels(ids, weights, np.ascontiguousarray(labels), threads))
    except ValueError as error:
        raise InputError(f"expected {error}; got {seen.ids.shape} of {len(labels)} Gaussians") from None


def render_channels(
    splats: SplatArrays,
    view: View,
    values: Float32[np.ndarray, "n c"],
    background: Float32[np.ndarray, " c"] | None = None,
    *,
    threads: int = 0,
    isa: str = "",
) -> Rendering:
    """Composite any per-Gaussian values, front to back, over a background (black if None).

    Raises: InputError: not one row of values per Gaussian, or a background of another length.
    Source: 3DGS Eq. 3.
    """
    n, channels = len(splats.opacities), values.shape[1]
    behind = np.zeros(channels, np.float32) if background is None else background
    if len(values) != n or behind.shape != (channels,):
        raise InputError(f"expected values ({n}, C) and background (C); got {values.shape} and {behind.shape}")
    splats = on_device_in_use(splats)
    if splats.engine is not None:
        there: Rendering = _on_device().render_channels(
            splats, view, np.ascontiguousarray(values), np.ascontiguousarray(behind)
        )
        return there
    canvas = view.width, view.height, np.ascontiguousarray(values), np.ascontiguousarray(behind)
    return Rendering(*_native.render(*_scene_and_camera(splats, view), *canvas, threads, checked_isa(isa)))


def sh_colors(
    sh: Float32[np.ndarray, "n k 3"],
    means: Float32[np.ndarray, "n 3"],
    center: np.ndarray,
    *,
    threads: int = 0,
    isa: str = "",
) -> Float32[np.ndarray, "n 3"]:
    """Return the colour of each Gaussian seen from `center` (world coordinates): max(0, 0.5 + SH(direction)).

    Source: 3DGS, "Spherical harmonics".
    """
    arrays = np.ascontiguousarray(sh), np.ascontiguousarray(means), np.asarray(center, np.float32)
    return np.asarray(_native.sh_colors(*arrays, threads, checked_isa(isa)))
