"""Renderings of a scene, of a part of it, or of any per-Gaussian values."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arrays import Flags, FloatRows, Image, PixelNumbers, PixelRows, RowIds
from ..errors import InputError
from ..kernels import SplatArrays, render_channels, sh_colors, splat_arrays
from ..kernels.cuda.devices import on_host
from ..scene.gaussians import Gaussians
from ..scene.views import View

MAX_PIXELS = 1 << 27  # of a picture, e.g. 16384x8192: drawing it takes about 3 GB
Index = RowIds | Flags


class Picture(NamedTuple):
    """Rendering of a scene.

    rgb: in [0, ...), linear in the file's colours. depth: expected camera z, 0 where nothing is. channels: the
    composited `values`, without columns if there were none.
    """

    rgb: Image
    alpha: PixelNumbers
    depth: PixelNumbers
    channels: PixelRows


def render(
    gaussians: Gaussians,
    view: View,
    *,
    select: Index | None = None,
    values: FloatRows | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    threads: int = 0,
    splats: SplatArrays | None = None,
) -> Picture:
    """Render RGB, alpha, expected depth and any per-Gaussian `values` (composited over zero).

    select: indices or a boolean mask; only these Gaussians exist in the picture.
    splats: `splat_arrays(gaussians)`, to save its making when many views are rendered.

    Raises: InputError: values without one row per Gaussian; more than 134 million pixels.
    Source: 3DGS Eq. 3.

    >>> ds.render(scene.gaussians, scene.views[0]).rgb.shape
    (72, 96, 3)
    """
    if view.width * view.height > MAX_PIXELS:
        raise InputError(
            f"{view.name}: expected up to {MAX_PIXELS:,} pixels, got {view.width}x{view.height}: render it smaller "
            "with max_side=PIXELS"
        )
    extra = np.empty((len(gaussians), 0), np.float32) if values is None else values
    if len(extra) != len(gaussians):
        raise InputError(f"values: expected {len(gaussians)} rows, one per Gaussian; got {len(extra)}")
    arrays = splats or splat_arrays(gaussians)
    if select is not None:
        gaussians, extra = gaussians.subset(select), extra[select]
        arrays = arrays.subset(select)
    eye = view.relative_to(arrays.origin).center
    colors = sh_colors(gaussians.sh, on_host(arrays.means).T, eye, threads=threads)
    behind = np.concatenate([np.asarray(background, np.float32), np.zeros(extra.shape[1], np.float32)])
    image, alpha, depth = render_channels(arrays, view, np.hstack([colors, extra]), behind, threads=threads)
    return Picture(image[..., :3], alpha, depth, image[..., 3:])
