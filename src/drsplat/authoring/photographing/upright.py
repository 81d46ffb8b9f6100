"""Upward direction of a scene that has no photos to tell it."""

import numpy as np

from ...base.arrays import Float64
from ...scene.gaussians import Gaussians
from ..filming.looking import UP_WITHOUT_VIEWS
from .space import BOX_QUANTILES, solid_centers

MAX_HEIGHT_SHARE = 0.75  # of the box's second shortest side: a shorter side is its height
SLICE_SHARE = 0.2  # of the height: the lowest and the highest slice are compared
FOOTPRINT_CELLS = 24  # along each of the other two sides
AXES = ("x", "y", "z")


def guessed_up(gaussians: Gaussians) -> Float64[np.ndarray, " 3"]:
    """Return the most likely upward axis of a scene.

    Rooms, and objects with the ground around them, are lower than they are wide, and a floor covers more of their
    outline than a ceiling, which few photos show. A scene without such a shortest side gets the -y of COLMAP's first
    camera.
    """
    points = solid_centers(gaussians)
    low, high = np.quantile(points, BOX_QUANTILES, axis=0)
    sides = high - low
    shortest, second = np.argsort(sides, kind="stable")[:2].tolist()
    if not sides[shortest] < MAX_HEIGHT_SHARE * sides[second]:
        return np.array(UP_WITHOUT_VIEWS)
    shares = (points - low) / np.maximum(sides, 1e-12)
    height = shares[:, shortest]
    below, above = (_footprint(shares[part], shortest) for part in (height < SLICE_SHARE, height > 1 - SLICE_SHARE))
    up = np.zeros(3)
    up[shortest] = 1.0 if below >= above else -1.0
    return up


def _footprint(shares: Float64[np.ndarray, "n 3"], axis: int) -> int:
    """Count the cells across an axis that contain points. shares: of the box, 0 to 1 inside."""
    flat = np.delete(shares, axis, axis=1)
    inside = ((flat >= 0) & (flat < 1)).all(1)
    return len(np.unique((flat[inside] * FOOTPRINT_CELLS).astype(int), axis=0))


def axis_name(up: Float64[np.ndarray, " 3"]) -> str:
    """Return "+z" and so on, or three numbers for a direction between the axes."""
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > 1 - 1e-9:
        return f"{'+' if up[axis] > 0 else '-'}{AXES[axis]}"
    return " ".join(f"{number:.3f}" for number in up)
