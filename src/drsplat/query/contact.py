"""Contact between things: one rests on another whose Gaussians its lower ones touch, around or under its middle.

Boxes overlap, or hover by the thickness of a splat, and photos see little of what lies under a thing. Both say little
of whether it stands there; Gaussians beside its foot do. Defined in docs/grouping.md.
"""

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Float64, Integer
from ..scene.boxes import solid
from ..scene.parted import AnyGaussians

FOOT_SHARE = 0.1  # of a thing's height above its lower side: what can touch
TOUCHING_DEVIATIONS = 2.0  # of two Gaussians, towards each other
NUM_NEIGHBOURS = 8
SPACING_NEIGHBOUR = 3  # whose median distance is the typical spacing
MIN_TOUCHING_SHARE = 0.1  # of the foot's Gaussians
MAX_ENCLOSED_GAP_RADIANS = np.pi  # without contact around what cannot fall off
MAX_ONE_SIDED_GAP_RADIANS = 4 / 3 * np.pi  # the same where only the foot touches: photos see one side of a shelf

Points = Float64[np.ndarray, "_ 3"]
Ids = Integer[np.ndarray, " _"]
Up = Float64[np.ndarray, " 3"]


def rests_on(gaussians: AnyGaussians, thing: Ids, support: Ids, up: Up) -> bool:
    """Return whether some Gaussians rest on others, by contact.

    Args:
        gaussians: the scene.
        thing: rows of what may rest; those that can be seen count, here and of the support.
        support: rows of what it may rest on; those that it shares do not count, so that nothing is on itself.
        up: the unit direction that is up.
    """
    own = solid(gaussians, thing)
    heights, others = _centers(gaussians, own) @ up, solid(gaussians, np.setdiff1d(support, thing))
    low, high = np.quantile(heights, (0.02, 0.98))
    ankle = low + FOOT_SHARE * (high - low)
    foot, rest = own[heights <= ankle], own[heights > ankle]
    touching, touched = contacts(gaussians, own, foot, others)
    if len(touching) < max(MIN_TOUCHING_SHARE * len(foot), 1):
        return False
    places = _centers(gaussians, touched)
    if heights.mean() <= (places @ up).mean():
        return False
    gap = widest_gap(places, _centers(gaussians, foot).mean(axis=0), up)
    if MAX_ENCLOSED_GAP_RADIANS < gap <= MAX_ONE_SIDED_GAP_RADIANS:
        beside = contacts(gaussians, own, rest, others)[1]
        return not len(beside) or bool((_centers(gaussians, beside) @ up).mean() <= ankle)
    return gap <= MAX_ENCLOSED_GAP_RADIANS


def contacts(gaussians: AnyGaussians, thing: Ids, part: Ids, others: Ids) -> tuple[Ids, Ids]:
    """Return those rows of a part of a thing that touch others, and those of the others that they touch, each once.

    Two touch where their centres are no further apart than two standard deviations of both, along the line between
    them, and the mean of the typical spacings of the thing and of the others there. Of each, the eight nearest others
    are looked at. Things of so few Gaussians that they have no spacing touch nothing.
    """
    others = _near(gaussians, part, others)
    if min(len(others), len(thing)) <= SPACING_NEIGHBOUR or not len(part):
        return part[:0], others[:0]
    here, there = (_centers(gaussians, ids) for ids in (part, others))
    spacing = (_spacing(_centers(gaussians, thing)) + _spacing(there)) / 2
    distances, nearest = cKDTree(there).query(here, np.arange(1, min(NUM_NEIGHBOURS, len(others)) + 1))
    first, second = np.repeat(part, nearest.shape[1]), others[nearest.ravel()]
    along = there[nearest.ravel()] - np.repeat(here, nearest.shape[1], axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    deviations = _deviations(gaussians, first, along) + _deviations(gaussians, second, along)
    touch = distances.ravel() <= TOUCHING_DEVIATIONS * deviations + spacing
    return np.unique(first[touch]), np.unique(second[touch])


def _near(gaussians: AnyGaussians, part: Ids, others: Ids) -> Ids:
    """Return the others in the box of a part of a thing, widened by half of its diagonal."""
    here, there = (_centers(gaussians, ids) for ids in (part, others))
    if not len(here):
        return others[:0]
    low, high = here.min(axis=0), here.max(axis=0)
    margin = float(np.linalg.norm(high - low)) / 2
    return np.asarray(others[((there >= low - margin) & (there <= high + margin)).all(axis=1)])


def widest_gap(places: Points, middle: Up, up: Up) -> float:
    """Return the widest angle, seen from above, in which none of some places lies around a middle, in radians."""
    east = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    offsets = places - middle
    angles = np.sort(np.arctan2(offsets @ np.cross(up, east), offsets @ east))
    return float(np.diff(np.append(angles, angles[0] + 2 * np.pi)).max())


def _centers(gaussians: AnyGaussians, ids: Ids) -> Points:
    return gaussians.shapes_of(ids).positions


def _spacing(points: Points) -> float:
    """Return the typical distance to a near neighbour."""
    return float(np.median(cKDTree(points).query(points, SPACING_NEIGHBOUR + 1)[0][:, -1]))


def _deviations(gaussians: AnyGaussians, ids: Ids, directions: Points) -> Float64[np.ndarray, " _"]:
    """Return the standard deviation of each Gaussian along a unit direction of its own."""
    covariances = gaussians.shapes_of(ids).covariances().astype(np.float64)
    a, b = np.triu_indices(3)
    factors = np.where(a == b, 1.0, 2.0) * directions[:, a] * directions[:, b]
    return np.asarray(np.sqrt(np.maximum((covariances * factors).sum(axis=1), 0)))
