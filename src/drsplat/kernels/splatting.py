"""Blending weights of Gaussians in a view, and images made from them (native; float32).

Semantics are those of 3D Gaussian Splatting: see docs/method.md, "Blending weights". Every function is
the same to the bit for any number of threads. `threads=0` takes all cores; `isa` names an instruction
set of `available_isas()`, "" the best (or what the variable DRSPLAT_ISA names).
"""

import numpy as np

from .. import _native
from ..base.arrays import Float32, FloatRows, Harmonics, Ids, MaskIds, Vectors
from ..errors import InputError
from ..scene.gaussians import Gaussians
from ..scene.views import View
from .cuda.devices import engine_in_use
from .splats import (
    MAX_COUNT,
    Contributions,
    Rendering,
    SplatArrays,
    Triples,
    camera_numbers,
    checked_isa,
    native_array,
    splat_arrays_at_origin,
)


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
    from .cuda import drawing

    return drawing.sent_splats(engine, splats)


def _scene_and_camera(splats: SplatArrays, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool, np.ndarray]:
    """Return means, covariances, opacities, whether they are drawn antialiased, and the camera."""
    return (
        splats.means,
        splats.covariances,
        splats.opacities,
        splats.antialiased,
        camera_numbers(view.relative_to(splats.origin), splats.near),
    )


def _positive(name: str, value: int | None) -> int:
    if value is not None and value < 1:
        raise InputError(f"{name}: expected a positive integer, or None for all; got {value}")
    return min(value or 0, MAX_COUNT)


def view_weights(
    splats: SplatArrays,
    view: View,
    mask_ids: MaskIds,
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
        from .cuda import drawing

        return drawing.view_weights(splats, view, pixels, *limits)
    triples = _native.view_weights(*_scene_and_camera(splats, view), pixels, *limits, threads, checked_isa(isa))
    return Triples(*triples[:3])


def release_workspaces() -> None:
    """Give back the memory that is kept for the next view: about 100 bytes for each Gaussian that is seen."""
    _native.release_workspaces()


def topk_contributions(
    splats: SplatArrays, view: View, k: int, *, first_hits: int | None = None, threads: int = 0, isa: str = ""
) -> Contributions:
    """Return the k largest blending weights of each pixel and the Gaussians that own them.

    Descending in weight; ties front to back. 8k bytes per pixel.

    Raises: InputError: k < 1.
    Source: Dr. Splat Sec. A; 3DGS Eq. 3.
    """
    size, limits = view.size, (_positive("k", k), _positive("first_hits", first_hits))
    splats = on_device_in_use(splats)
    if splats.engine is not None:
        from .cuda import drawing

        return drawing.topk_contributions(splats, view, *limits)
    arrays = _scene_and_camera(splats, view)
    return Contributions(*_native.topk_contributions(*arrays, *size, *limits, threads, checked_isa(isa)))


def heaviest_labels(seen: Contributions, labels: Ids, *, threads: int = 0) -> MaskIds:
    """Return the label with the most weight in each pixel, -1 for none; ties go to the heaviest Gaussian's.

    seen: the eight largest weights of each pixel. labels: one per Gaussian.

    Raises: InputError: another number of weights, or Gaussians without a label.
    """
    got = f"; got {seen.ids.shape} of {len(labels)} Gaussians"
    return native_array("labels", _native.heaviest_labels, *seen, labels, threads, got=got)


def render_channels(
    splats: SplatArrays,
    view: View,
    values: FloatRows,
    background: Float32[np.ndarray, " k"] | None = None,
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
        from .cuda import drawing

        return drawing.render_channels(splats, view, np.ascontiguousarray(values), np.ascontiguousarray(behind))
    canvas = view.width, view.height, np.ascontiguousarray(values), np.ascontiguousarray(behind)
    return Rendering(*_native.render(*_scene_and_camera(splats, view), *canvas, threads, checked_isa(isa)))


def sh_colors(sh: Harmonics, means: Vectors, center: np.ndarray, *, threads: int = 0, isa: str = "") -> Vectors:
    """Return the colour of each Gaussian seen from `center` (world coordinates): max(0, 0.5 + SH(direction)).

    Source: 3DGS, "Spherical harmonics".
    """
    arrays = sh, means, np.asarray(center, np.float32)
    return native_array("colours", _native.sh_colors, *arrays, threads, checked_isa(isa))
