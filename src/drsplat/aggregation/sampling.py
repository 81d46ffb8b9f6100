"""Where the photos are looked at: every pixel of a mask, or those that hold a Gaussian's centre."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int32, Int64

from ..errors import InputError
from ..kernels import SplatArrays, Triples, view_weights
from ..views import View

PIXELS_AT_ONCE = 1 << 16  # times about a hundred contributors of 12 bytes: 80 MB


@dataclass(frozen=True)
class Sampling:
    """What W is made of. topk None: all contributors of a pixel. first_hits: only the first ones of each ray.

    near: camera z up to which nothing is seen, scene units; None: the scene's own (`Gaussians.near`).
    pixels: "all" adds up the pixels of a mask; "centre" takes, of each view, only the pixel that holds the
    projected centre of the Gaussian, with all of its contributors, whatever their rank.

    Raises: InputError: another kind of pixels; topk or first_hits with centres, or less than 1; a near plane
    that is not in front of the camera.
    """

    topk: int | None = 40
    first_hits: int | None = None
    pixels: Literal["all", "centre"] = "all"
    near: float | None = None

    def __post_init__(self) -> None:
        if self.pixels not in ("all", "centre"):
            raise InputError(f"pixels: expected 'all' or 'centre', got {self.pixels!r}")
        for name, value in (("topk", self.topk), ("first_hits", self.first_hits)):
            if value is not None and value < 1:
                raise InputError(
                    f"{name}: expected a positive integer, or None for all; got {value}"
                )
        if self.near is not None and not 0 < self.near < np.inf:
            raise InputError(f"near: expected a distance in front of the camera, got {self.near}")
        if self.pixels == "centre" and (self.topk, self.first_hits) != (None, None):
            raise InputError(
                "centre pixels count whatever their rank: leave topk and first_hits at None"
            )

    def triples(
        self,
        splats: SplatArrays,
        view: View,
        segment_ids: Int32[np.ndarray, "h w"],
        threads: int = 0,
    ) -> Triples:
        """The entries of W of one view."""
        if self.pixels == "centre":
            return centre_weights(splats, view, segment_ids, threads=threads)
        return view_weights(
            splats, view, segment_ids, self.topk, first_hits=self.first_hits, threads=threads
        )


CENTRES = Sampling(None, None, "centre")


def centre_weights(
    splats: SplatArrays,
    view: View,
    segment_ids: Int32[np.ndarray, "h w"],
    *,
    threads: int = 0,
) -> Triples:
    """Per Gaussian its blending weight alpha T at the pixel of its centre, and the segment there.

    At most one entry per Gaussian; none where it adds nothing there, or where no mask is.

    Source: Occam's LGS (BMVC 2025).  Twin: tests/test_aggregation_sampling.py::slow_centre_weights.
    """
    pixels = centre_pixels(splats, view)
    wanted = np.unique(pixels[pixels >= 0])
    wanted = wanted[segment_ids.ravel()[wanted] >= 0]
    chunks = [
        _weights_at(splats, view, pixels, wanted[begin : begin + PIXELS_AT_ONCE], threads)
        for begin in range(0, len(wanted), PIXELS_AT_ONCE)
    ]
    ids = np.concatenate([chunk[0] for chunk in chunks] or [np.empty(0, np.uint32)])
    weights = np.concatenate([chunk[1] for chunk in chunks] or [np.empty(0, np.float32)])
    order = np.argsort(ids, kind="stable")
    ids = ids[order]
    return Triples(ids, segment_ids.ravel()[pixels[ids]], weights[order])


def centre_pixels(splats: SplatArrays, view: View) -> Int64[np.ndarray, " n"]:
    """Per Gaussian the pixel (row by row) that its centre projects into; -1 outside or behind."""
    pose, K = view.relative_to(splats.origin).cam_from_world, view.K
    x, y, z = (pose[row, :3] @ splats.means.astype(np.float64) + pose[row, 3] for row in range(3))
    ahead = z > 0
    depth = np.where(ahead, z, 1)
    column = np.floor(K[0, 0] * x / depth + K[0, 2])
    row = np.floor(K[1, 1] * y / depth + K[1, 2])
    inside = ahead & (column >= 0) & (column < view.width) & (row >= 0) & (row < view.height)
    return np.where(inside, row * view.width + column, -1).astype(np.int64)


def _weights_at(
    splats: SplatArrays,
    view: View,
    pixels: Int64[np.ndarray, " n"],
    chosen: Int64[np.ndarray, " p"],
    threads: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Gaussians whose centre is in one of the chosen pixels, and their weights there."""
    # Every pixel is a segment of its own, so that W has its contributors one by one.
    own = np.full(view.width * view.height, -1, np.int32)
    own[chosen] = np.arange(len(chosen), dtype=np.int32)
    found = view_weights(splats, view, own.reshape(view.height, view.width), None, threads=threads)
    at_centre = pixels[found.gaussian_ids] == chosen[found.segment_ids]
    return found.gaussian_ids[at_centre], found.weights[at_centre]
