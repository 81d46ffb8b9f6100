"""Which objects are surfaces, such as floors, walls and table tops, by their shape alone."""

import numpy as np

from ...base.arrays import Ids, Points
from ...scene.boxes import solid
from ...scene.parted import AnyGaussians
from ..forest import by_number

NEAREST_SHARE, ROUNDS = 0.8, 4  # of the Gaussians, those nearest to the plane, to which it is fitted again
MAX_RELIEF = 0.12  # standard deviation across the plane, of that along its shorter side
MIN_SIDE, MIN_SIDE_AROUND = 0.0346, 0.144
"""Standard deviation along the shorter side, of the scene's size: of what is flat, and of walls around a room.

If Gaussians are spread evenly, these are sides of 0.12 and 0.5 of the size."""


def surfaces(object_of: Ids, count: int, gaussians: AnyGaussians, size: float) -> list[bool]:
    """Return whether each object is flat and large, or so large that it goes around the scene.

    What lies on a table top or holds it does not count: a fifth of an object's Gaussians may be anywhere.

    Args:
        object_of: number of each Gaussian's object, -1 for none.
        count: objects.
        gaussians: the scene; one in parts is read along its rows.
        size: diagonal of the scene, in its units.
    """
    order, starts = by_number(object_of, count)
    each = np.split(order, starts)[1:-1]
    found = [False] * count
    for number in sorted(range(count), key=lambda number: int(each[number][0])):
        shapes = gaussians.shapes_of(solid(gaussians, each[number]))
        found[number] = _is_surface(shapes.means.astype(np.float64), size)
    return found


def _is_surface(points: Points, size: float) -> bool:
    near = points
    for _ in range(ROUNDS):
        variance, axes = np.linalg.eigh(np.cov(near.T, bias=True))
        across = np.abs((points - near.mean(0)) @ axes[:, 0])
        near = points[across <= np.quantile(across, NEAREST_SHARE)]
    relief, side, _ = np.sqrt(np.maximum(variance, 0))
    least = MIN_SIDE if relief <= MAX_RELIEF * side else MIN_SIDE_AROUND
    return bool(side >= least * size)
