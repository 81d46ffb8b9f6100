"""Sampling of photos: which contributors of which pixels make W."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ....base.arrays import Int32
from ....errors import InputError
from ....kernels import SplatArrays, Triples, view_weights
from ....scene.views import View


@dataclass(frozen=True)
class Sampling:
    """Settings of W. topk None: all contributors of a pixel. first_hits: only the first ones of each ray.

    near: camera z up to which nothing is seen, scene units; None: the scene's own (`Gaussians.near`).
    pixels: "all" adds up the pixels of a mask. "centre" is in records only, of W that others made of the pixels
    that hold the Gaussians' centres; a subclass whose `triples` does so can be registered with.

    Raises: InputError: another kind of pixels; topk or first_hits less than 1; a near plane that is not in
    front of the camera.
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
                raise InputError(f"{name}: expected a positive integer, or None for all; got {value}")
        if self.near is not None and not 0 < self.near < np.inf:
            raise InputError(f"near: expected a distance in front of the camera, got {self.near}")

    def triples(self, splats: SplatArrays, view: View, mask_ids: Int32[np.ndarray, "h w"], threads: int = 0) -> Triples:
        """Return the entries of W of one view. Raises: InputError: `pixels` is not "all"."""
        if self.pixels != "all":
            raise InputError(f"pixels: only all of them can be registered, not '{self.pixels}'")
        return view_weights(splats, view, mask_ids, self.topk, first_hits=self.first_hits, threads=threads)
