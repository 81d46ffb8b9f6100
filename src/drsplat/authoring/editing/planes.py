"""The planes that something stands on or before: ground and walls, from the Gaussians around it."""

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Doubles, Flags, Float64, Indices, OtherPoints, PlanePoints, Points, Vector3, Vectors

RANSAC_TRIES = 300
MAX_RANSAC_POINTS = 4000
TOLERANCE_SHARE = 0.04  # of the size of what stands there: how far from a plane its Gaussians may lie
SEARCH_MARGIN_SHARE = 0.8  # of a thing's size: how far around it planes, clones and loose parts are looked for
MIN_PLANE_GAUSSIANS = 40
MIN_PLANE_SHARE = 0.005  # of the Gaussians around
THICKNESS_MEDIANS = 4.0  # a plane's half thickness, in median distances from it
MIN_THICKNESS_SHARE = 0.2  # of the tolerance
MAX_TOUCHING_TOLERANCES = 4.0  # between a plane and what stands on it
MAX_THING_SHARE_BEHIND = 0.15  # of what stands there: roots from training, and mistakes of masks
MIN_SIDES = 4  # of eight directions from its middle in which the plane must continue
SIDE_REACH = 1.6  # in each direction the plane counts up to so many times the thing's own reach
MIN_SIDE_SHARE = 0.01  # of the plane's Gaussians, for a direction in which it continues
SAME_NORMAL_COSINE = 0.9  # between planes that are one surface, found twice
BEHIND_TOLERANCES = 2.0  # below a plane, from which on a point is behind it
MAX_SHARE_BEHIND = 0.5  # of all points: fewer lie beyond floors and walls, and below a table
MAX_PLANES = 3
MAX_SEARCHES = 12
Thing = Float64[np.ndarray, "t 3"]


@dataclass(frozen=True, eq=False)
class Plane:
    """Points x with normal . x = offset; the normal points to where the object is. axes: two in it, at right angles."""

    normal: Vector3
    offset: float
    axes: Float64[np.ndarray, "2 3"]
    tolerance: float

    def heights(self, points: Points) -> Doubles:
        return np.einsum("ni,i->n", points, self.normal) - self.offset

    def flat(self, points: Points) -> PlanePoints:
        """Return the places in the plane, in scene units."""
        return np.einsum("ni,ai->na", points, self.axes)

    def holds(self, points: Points) -> Flags:
        return np.abs(self.heights(points)) <= self.tolerance


def tolerance_of(thing: Thing) -> float:
    """Return how far from a plane below or behind a thing the plane's Gaussians may lie, in scene units."""
    return TOLERANCE_SHARE * float(np.linalg.norm(np.ptp(thing, axis=0)))


def near_thing(means: Vectors, thing: OtherPoints) -> tuple[Flags, float]:
    """Return which Gaussians lie in the thing's box or around it, where planes are fitted, and the size of that box."""
    low, high = np.quantile(thing, (0.01, 0.99), axis=0)
    size = float(np.linalg.norm(high - low))
    reach = SEARCH_MARGIN_SHARE * size
    return ((means >= low - reach) & (means <= high + reach)).all(1), size


def surfaces_around(thing: Thing, around: Points) -> list[Plane]:
    """Return up to three planes that a thing touches and stands before, the largest first.

    Most of the points around are on the thing's side of each: none lies across several other things.
    """
    rng, rest, planes = np.random.default_rng(0), around, list[Plane]()
    least = max(MIN_PLANE_GAUSSIANS, int(MIN_PLANE_SHARE * len(around)))
    for _ in range(MAX_SEARCHES):  # some that are large are none that it stands on
        plane = _largest(rest, thing, rng) if len(rest) >= least else None
        if plane is None:
            break
        inside = plane.holds(rest)
        if np.count_nonzero(inside) < least:
            break
        # a thing stands on one ground, and before one wall of each direction
        is_new = all(abs(float(plane.normal @ other.normal)) < SAME_NORMAL_COSINE for other in planes)
        if is_new and _stands_on(plane, thing, rest[inside]):
            behind = plane.heights(around) < -BEHIND_TOLERANCES * plane.tolerance
            planes += [plane] if behind.mean() <= MAX_SHARE_BEHIND else []
        rest = rest[~inside]
    return planes[:MAX_PLANES]


def largest_plane(points: Points, thing: Thing) -> Plane | None:
    """Return the plane that most of some points lie in, its normal to where a thing is; None for points on a line."""
    return _largest(points, thing, np.random.default_rng(0))


def _largest(points: Points, thing: Thing, rng: np.random.Generator) -> Plane | None:
    """Return the plane through three of the points that most of them lie in, fitted to these."""
    some = points[:: -(-len(points) // MAX_RANSAC_POINTS)]
    best, most, tolerance = None, 0, tolerance_of(thing)
    a, b, c = some[rng.integers(len(some), size=(RANSAC_TRIES, 3))].transpose(1, 0, 2)
    for start, normal in zip(a, np.cross(b - a, c - a), strict=True):
        length = float(np.linalg.norm(normal))
        if length > 0:
            inside = np.abs(np.einsum("ni,i->n", some - start, normal / length)) <= tolerance
            count = int(np.count_nonzero(inside))
            best, most = (inside, count) if count > most else (best, most)
    return None if best is None else _fitted(some[best], thing, tolerance)


def _fitted(points: Points, thing: Thing, tolerance: float) -> Plane:
    middle = points.mean(0)
    away = points - middle
    axes = np.linalg.eigh(np.einsum("ni,nj->ij", away, away))[1].T
    normal = axes[0]
    if np.median(np.einsum("ni,i->n", thing - middle, normal)) < 0:
        normal = -normal
    thickness = THICKNESS_MEDIANS * float(np.median(np.abs(np.einsum("ni,i->n", away, normal))))
    return Plane(
        normal, float(normal @ middle), axes[1:], min(tolerance, max(thickness, MIN_THICKNESS_SHARE * tolerance))
    )


def _stands_on(plane: Plane, thing: Thing, ground: Points) -> bool:
    """Return True if a thing is before a plane, touches it, and has it on several sides."""
    heights, tolerance = plane.heights(thing), tolerance_of(thing)
    before = float((heights < -tolerance).mean()) <= MAX_THING_SHARE_BEHIND
    touches = float(np.quantile(heights, 0.02)) <= MAX_TOUCHING_TOLERANCES * tolerance
    return before and touches and num_sides(plane.flat(thing), plane.flat(ground)) >= MIN_SIDES


def num_sides(thing: PlanePoints, ground: Float64[np.ndarray, "m 2"]) -> int:
    """Count in how many of eight directions the ground begins where a thing ends."""
    middle = np.median(thing, axis=0)
    (own, reach), (other, distance) = (_polar(points - middle) for points in (thing, ground))
    ends = [float(np.quantile(reach[own == k], 0.95)) if (own == k).any() else 0.0 for k in range(8)]
    least = max(3, int(MIN_SIDE_SHARE * len(ground)))
    beside = [np.count_nonzero(distance[other == k] <= SIDE_REACH * max(ends[k], ends[k - 4])) for k in range(8)]
    return sum(int(number) >= least for number in beside)


def _polar(away: PlanePoints) -> tuple[Indices, Doubles]:
    """Return eighths of a turn, and distances."""
    eighths = np.floor((np.arctan2(away[:, 1], away[:, 0]) + np.pi) / (np.pi / 4)).astype(np.int64) % 8
    return eighths, np.linalg.norm(away, axis=1)
