"""Selection by an outline in a picture."""

import numpy as np
from PIL import Image, ImageDraw

from ...base.arrays import Float64, Int32, Int64
from ...kernels import SplatArrays, view_weights
from ...scene.views import View

GAUSSIANS_PER_PIXEL = 8  # the heaviest: those behind what is seen have next to no weight
MIN_INSIDE_SHARE = 0.5  # of a Gaussian's weight in the picture
MIN_WEIGHT_PIXELS = 0.02  # of a Gaussian in the whole picture


def inside_outline(
    splats: SplatArrays, view: View, outline: Float64[np.ndarray, "p 2"], *, threads: int = 0
) -> Int64[np.ndarray, " m"]:
    """Return the Gaussians, ascending, of which most that a view shows lies inside an outline.

    outline: corners of a polygon, in pixels of the view.
    """
    seen = view_weights(splats, view, _filled(view, outline), GAUSSIANS_PER_PIXEL, threads=threads)
    weights = seen.weights.astype(np.float64)
    count = len(splats.opacities)
    every = np.bincount(seen.gaussian_ids, weights, minlength=count)
    inside = np.bincount(seen.gaussian_ids, weights * (seen.mask_ids == 1), minlength=count)
    return np.flatnonzero((inside > MIN_INSIDE_SHARE * every) & (every >= MIN_WEIGHT_PIXELS))


def _filled(view: View, outline: Float64[np.ndarray, "p 2"]) -> Int32[np.ndarray, "h w"]:
    """Return 1 for each pixel inside a polygon and 0 for the others."""
    picture = Image.new("L", (view.width, view.height))
    corners = np.clip(outline, -8 * max(view.width, view.height), 9 * max(view.width, view.height))
    ImageDraw.Draw(picture).polygon([tuple(corner) for corner in corners.tolist()], fill=1)
    return np.asarray(picture, np.int32)
