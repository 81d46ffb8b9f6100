"""Which way is up in a scene that has no photos to tell."""

import numpy as np

from ..arrays import Float64
from ..filming.looking import UP_WITHOUT_VIEWS
from ..scene.gaussians import Gaussians
from .space import BOX_QUANTILES, solid_centers

THIN = 0.75  # of the second shortest side of the box: a side that is shorter is its height
SLICE = 0.2  # of the height: the lowest and the highest part are compared
CELLS = 24  # along each of the other two sides
AXES = ("x", "y", "z")


def guessed_up(gaussians: Gaussians) -> Float64[np.ndarray, " 3"]:
    """Return the axis that a scene most likely has upward.

    Rooms, and things with the ground around them, are lower than they are wide, and a floor covers more of their
    outline than a ceiling, which few photos show. A scene without such a shortest side has the -y of COLMAP's first
    camera.
    """
    points = solid_centers(gaussians)
    low, high = np.quantile(points, BOX_QUANTILES, axis=0)
    sides = high - low
    shortest, second = np.argsort(sides, kind="stable")[:2].tolist()
    if not sides[shortest] < THIN * sides[second]:
        return np.array(UP_WITHOUT_VIEWS)
    shares = (points - low) / np.maximum(sides, 1e-12)
    height = shares[:, shortest]
    below, above = (_footprint(shares[part], shortest) for part in (height < SLICE, height > 1 - SLICE))
    up = np.zeros(3)
    up[shortest] = 1.0 if below >= above else -1.0
    return up


def _footprint(shares: Float64[np.ndarray, "n 3"], axis: int) -> int:
    """Return in how many cells of the outline across an axis some points are. shares: of the box, 0 to 1 inside."""
    flat = np.delete(shares, axis, axis=1)
    inside = ((flat >= 0) & (flat < 1)).all(1)
    return len(np.unique((flat[inside] * CELLS).astype(int), axis=0))


def axis_name(up: Float64[np.ndarray, " 3"]) -> str:
    """Return "+z" and so on, or three numbers for a direction between the axes."""
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > 1 - 1e-9:
        return f"{'+' if up[axis] > 0 else '-'}{AXES[axis]}"
    return " ".join(f"{number:.3f}" for number in up)
