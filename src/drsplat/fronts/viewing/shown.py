"""Which Gaussians a browser is given, in which frame, from where they are first seen, and boxes in that frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.arrays import Array, Float32, Float64, Numbers, Shaped, UInt8, Vector3, Vectors, WholeNumbers
from ...errors import InputError
from ...query import documents
from ...scene.gaussians import SH_C0, Gaussians, most_significant
from ...scene.views import View

RADIUS = (
    10.0  # of what is shown, in the browser's units: a Gaussian of a thousandth is 1e-4 squared, which float16 holds
)
WITHIN_RADIUS_SHARE = 0.9  # of the solid Gaussians
MIDDLE_QUANTILES = (0.02, 0.98)  # along each axis, whose mean is the middle: few floaters move it little
MAX_VARIANCE = 6e4  # float16 ends at 65504
OUTSIDE_RADII = 2.7  # a ball of one radius fits into 55 degrees from 2.2 on


@dataclass(frozen=True, eq=False)
class Frame:
    """Frame of the scene in the browser: x_shown = scale * (x_world - center); directions stay."""

    center: Vector3
    scale: float

    def shown(self, points: Float64[Array, "*n 3"]) -> Float64[Array, "*n 3"]:
        return self.scale * (points - self.center)

    def world(self, points: Float64[Array, "*n 3"]) -> Float64[Array, "*n 3"]:
        return points / self.scale + self.center


@dataclass(frozen=True, eq=False)
class Shown:
    """The `ids` of a scene that are shown, ascending, and what they look like from afar.

    centers, covariances: in the browser's frame. rgb: the colour without view dependence, in [0, 1].
    num_left_out: Gaussians beyond the budget. antialiased: as of `Gaussians`.
    """

    ids: WholeNumbers
    centers: Vectors
    covariances: Float32[Array, "n 6"]
    rgb: Vectors
    opacities: Numbers
    frame: Frame
    num_left_out: int
    antialiased: bool = False

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def summary(self) -> str:
        """Sentence about what is left out, empty where nothing is."""
        if not self.num_left_out:
            return ""
        total = len(self) + self.num_left_out
        return f"Shown are the {len(self):,} most significant of {total:,} Gaussians; answers are of all of them."


def shown_of(gaussians: Gaussians, budget: int, frame: Frame | None = None) -> Shown:
    """Return the `budget` most significant Gaussians, in a frame that float16 covariances can bear or a given one.

    Raises: InputError: a budget below 1, or a scene without Gaussians.
    """
    if budget < 1 or not len(gaussians):
        raise InputError(
            f"nothing to show: {len(gaussians)} Gaussians and room for {budget}; give a scene and a budget of 1 or more"
        )
    ids = most_significant(gaussians, budget)
    part = gaussians if len(ids) == len(gaussians) else gaussians.subset(ids)
    frame = frame or frame_of(gaussians)
    return Shown(ids, *shown_part(part, frame), frame, len(gaussians) - len(ids), gaussians.antialiased)


def shown_part(part: Gaussians, frame: Frame) -> tuple[Array, Array, Array, Array]:
    """Return centres, covariances, colours and opacities of a part of a scene in a frame.

    Centres beyond float32 are put at its ends, where nobody looks.
    """
    farthest = float(np.finfo(np.float32).max)
    centers = np.asarray(np.clip(frame.shown(part.positions), -farthest, farthest), np.float32)
    return centers, _shown_covariances(part, frame), base_colors(part), part.opacities


def moved_shown(shown: Shown, gaussians: Gaussians) -> Shown:
    """Return the same Gaussians, in the same frame, where a state of the scene has them."""
    part = gaussians if len(shown) == len(gaussians) else gaussians.subset(shown.ids)
    return Shown(shown.ids, *shown_part(part, shown.frame), shown.frame, shown.num_left_out, shown.antialiased)


def _shown_covariances(part: Gaussians, frame: Frame) -> Float32[Array, "m 6"]:
    covariances = np.empty((len(part), 6), np.float32)
    block = 1 << 16  # bounds the float64 temporaries
    for begin in range(0, len(part), block):
        rows = np.arange(begin, min(begin + block, len(part)))
        shown = part.subset(rows).covariances() * frame.scale**2
        covariances[rows] = np.clip(shown, -MAX_VARIANCE, MAX_VARIANCE)
    return covariances


def base_colors(gaussians: Gaussians) -> Vectors:
    """Return colours without what depends on the direction of view, in [0, 1]."""
    return np.clip(0.5 + SH_C0 * gaussians.sh[:, 0], 0, 1).astype(np.float32)


def frame_of(gaussians: Gaussians) -> Frame:
    """Return a frame in the middle of the solid Gaussians, `WITHIN_RADIUS_SHARE` of which are inside of `RADIUS`."""
    solid = gaussians.positions[gaussians.opacities >= 0.1]
    points = solid if len(solid) else gaussians.positions
    center = np.quantile(points, MIDDLE_QUANTILES, axis=0).mean(0)
    reach = float(np.quantile(np.linalg.norm(points - center, axis=1), WITHIN_RADIUS_SHARE))
    return Frame(center, RADIUS / reach if reach > 0 else 1.0)


def first_look(views: Sequence[View], frame: Frame, up: Vector3) -> tuple[Vector3, Vector3]:
    """Return where to begin and what to look at: from one of the photos, else from outside, with all in the picture."""
    if not views:
        side = np.array([0.8, 0.5, 0.3])
        side = side - (side @ up) * up + 0.4 * up
        return frame.center + OUTSIDE_RADII * RADIUS / frame.scale * side / np.linalg.norm(side), frame.center
    view = views[len(views) // 2]
    ahead = view.cam_from_world[2, :3]
    reach = max(float(ahead @ (frame.center - view.center)), 1 / frame.scale)
    return view.center, view.center + reach * ahead


DECIMALS = 5  # a browser's unit is a twentieth of the scene


def as_bytes(values: Shaped[Array, "*any"]) -> UInt8[Array, "*any"]:
    """Return numbers in [0, 1] as bytes."""
    return np.asarray(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def rounded(values: Shaped[Array, "*any"]) -> list[Any]:
    return documents.rounded(values, DECIMALS)


def size_text(extent: Vector3) -> str:
    """Return the lengths of a box in scene units, such as "0.12 x 0.08 x 0.09"."""
    return " x ".join(f"{x:.3g}" for x in extent)


def place_text(point: Vector3) -> str:
    """Return a place in the world, such as "0.30, 0.14, 0.82"."""
    return ", ".join(f"{round(float(x), 2) + 0.0:.2f}" for x in point)
