"""Settings of a capture."""

import math
from dataclasses import dataclass

from ...errors import InputError
from .measuring import KnownDistance

LENSES = {
    "pinhole": ("SIMPLE_PINHOLE", 0), "radial": ("SIMPLE_RADIAL", 1), "opencv": ("OPENCV", 4),
    "fisheye": ("OPENCV_FISHEYE", 4),
}  # fmt: skip
"""COLMAP's camera model of each lens, and its number of distortion parameters."""
UNDISTORTED = ("fisheye",)
"""Lenses whose photos are written as pinhole photos."""
SCALE, KNOWN_DISTANCE = "scale", "known distance"


@dataclass(frozen=True)
class CaptureSettings:
    """Settings of a capture.

    lens: of `LENSES`. scale: metres per unit of the capture without it. known_distance: between two places in
    photos or two markers, instead of `scale`. invert_masks: black is kept, white left out. keep_people: none are left
    out of photos that come without masks.

    Raises: InputError: an unknown lens, a scale that is not above 0, or both.
    """

    lens: str = "radial"
    scale: float | None = None
    known_distance: KnownDistance | None = None
    invert_masks: bool = False
    keep_people: bool = False

    def __post_init__(self) -> None:
        if self.lens not in LENSES:
            raise InputError(f"lens: expected one of {', '.join(LENSES)}, got {self.lens!a}")
        if self.scale is not None and not 0 < self.scale < math.inf:
            raise InputError(f"scale: expected a number above 0, got {self.scale:g}")
        if self.scale is not None and self.known_distance is not None:
            raise InputError("scale and known_distance both say how long a metre is: give one")
