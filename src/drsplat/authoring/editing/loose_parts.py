"""Gaussians that belong to a thing though no object says so: half a wheel that masks gave to the table under it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ...base.arrays import Bool, Float64, Int64
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import Gaussians
from ...scene.morton import morton_order
from .planes import MAX_THING_SHARE_BEHIND, MIN_PLANE_GAUSSIANS, Plane, largest_plane, num_sides

SEARCH_MARGIN_SHARE = 0.8  # of the thing's size: how far around it parts are looked for
MIN_FLAT_SHARE = 0.4  # of an object's area above its plane: with so much in the plane it is a floor, a table or a wall
MIN_SIDES = 3  # of eight directions from the thing in which a plane around it must continue
MIN_LIFT_TOLERANCES = 1.3  # above a plane, from which on a Gaussian is not part of it
GRAPH_NEIGHBOURS = 8
SPACING_NEIGHBOUR = 6  # neighbour whose distance counts as the spacing of a thing's Gaussians
MAX_STEP_SPACINGS = 1.5  # of a path between Gaussians, in median spacings of the thing's
MAX_SIZE_QUANTILE = 0.95  # of a thing's Gaussians: larger ones reach beyond it
Mask = Bool[np.ndarray, " n"]
Owners = Int64[np.ndarray, " n"]
Thing = Float64[np.ndarray, "t 3"]
Points = Float64[np.ndarray, "p 3"]


def loose_parts(
    gaussians: Gaussians, inside: Mask, owners: Owners, agreed: Bool[np.ndarray, " o"], threads: int = 0
) -> Mask:
    """Return the Gaussians that belong to a thing and to no other object that photos agree on.

    Loose are those of no object, those of an object that photos do not agree on, and those of a floor, table or wall
    that stand off its plane. They belong to the thing if it is the nearest of all things along a path of small steps
    over Gaussians off all these planes. What lies in a plane stays, and so does every other object.

    Args:
        gaussians: the scene.
        inside: the Gaussians of the thing.
        owners: number of each one's object, -1 for none.
        agreed: whether photos agree on each object.
        threads: 0 for all cores; the same Gaussians at any number.
    """
    thing = _solid(gaussians, inside)
    if len(thing) < MIN_PLANE_GAUSSIANS:
        return np.zeros_like(inside)
    low, high = np.quantile(thing, (0.01, 0.99), axis=0)
    size = float(np.linalg.norm(high - low))
    near = (
        (gaussians.means >= low - SEARCH_MARGIN_SHARE * size) & (gaussians.means <= high + SEARCH_MARGIN_SHARE * size)
    ).all(axis=1)
    others = near & ~inside & (owners >= 0)
    others[others] = agreed[owners[others]]
    standing, places = near & ~inside, gaussians.means[near].astype(np.float64)
    for ground in _grounds(gaussians, owners, others, ~inside, thing, size):
        others &= owners != ground.number
        standing[near] &= ground.plane.heights(places) > MIN_LIFT_TOLERANCES * ground.plane.tolerance
    sizes = gaussians.scales.max(axis=1)
    small = sizes <= np.quantile(sizes[inside], MAX_SIZE_QUANTILE)
    return _nearest_along_paths(gaussians, inside & near, others & standing, standing & ~others & small, threads)


@dataclass(frozen=True, eq=False)
class _Ground:
    """The plane of an object that is a floor, a table or a wall; and the object's number."""

    number: int
    plane: Plane


def _grounds(
    gaussians: Gaussians, owners: Owners, near: Mask, rest: Mask, thing: Thing, size: float
) -> Iterator[_Ground]:
    """Yield the objects that a thing stands on or before: planes as a whole, or near the thing.

    near, rest: Gaussians of other objects around the thing, and all that are not the thing's.
    """

    def is_large(on: Points, plane: Plane) -> bool:
        return float(np.ptp(np.quantile(plane.flat(on), (0.02, 0.98), axis=0), axis=0).min()) >= size

    def is_around(on: Points, plane: Plane) -> bool:
        return num_sides(plane.flat(thing), plane.flat(on)) >= MIN_SIDES

    for number in np.unique(owners[near]).tolist():
        rows = owners == number
        whole = _plane_of(gaussians, rows & rest, thing, is_large)
        plane = whole or _plane_of(gaussians, rows & near, thing, is_around)
        if plane is not None:
            yield _Ground(number, plane)


def _plane_of(gaussians: Gaussians, rows: Mask, thing: Thing, is_wide: Callable[[Points, Plane], bool]) -> Plane | None:
    """Return the plane that most of some Gaussians' area is in, None where there is none or the thing is behind it.

    What lies behind it does not count: below a glossy table training leaves what it mirrors.
    """
    rows = rows & (gaussians.opacities >= HAZE_OPACITY)
    points = gaussians.means[rows].astype(np.float64)
    plane = largest_plane(points, thing) if len(points) >= MIN_PLANE_GAUSSIANS else None
    if plane is None:
        return None
    areas = np.sort(gaussians.scales[rows].astype(np.float64), axis=1)[:, 1:].prod(axis=1) * gaussians.opacities[rows]
    heights = plane.heights(points)
    is_flat = areas[plane.holds(points)].sum() >= MIN_FLAT_SHARE * areas[heights >= -plane.tolerance].sum()
    is_before = float((plane.heights(thing) < -plane.tolerance).mean()) <= MAX_THING_SHARE_BEHIND
    return plane if is_flat and is_before and is_wide(points[plane.holds(points)], plane) else None


def _nearest_along_paths(gaussians: Gaussians, inside: Mask, others: Mask, loose: Mask, threads: int) -> Mask:
    """Return the loose Gaussians that are nearer to the thing than to any other, along paths of small steps."""
    rows = np.flatnonzero(inside | others | loose)
    places = gaussians.means[rows].astype(np.float64)
    order = morton_order(places)  # queries of neighbours, one after another, are fast
    found = cKDTree(places).query(places[order], range(2, GRAPH_NEIGHBOURS + 2), workers=threads or -1)
    distances, neighbours = (of_each[np.argsort(order)] for of_each in found)
    longest = MAX_STEP_SPACINGS * float(np.median(distances[inside[rows], SPACING_NEIGHBOUR - 1]))
    at, which = np.nonzero(distances <= longest)
    steps = np.maximum(distances[at, which], np.finfo(np.float64).tiny)  # a step of zero would be none
    graph = csr_array((steps, (at, neighbours[at, which])), shape=(len(rows), len(rows)))
    _, _, sources = dijkstra(
        graph, directed=False, indices=np.flatnonzero(~loose[rows]), min_only=True, return_predecessors=True
    )  # fmt: skip
    reached = np.flatnonzero(loose[rows] & (sources >= 0))
    belong = np.zeros_like(inside)
    belong[rows[reached]] = inside[rows[sources[reached]]]
    return belong


def _solid(gaussians: Gaussians, rows: Mask) -> Thing:
    return np.asarray(gaussians.means[rows & (gaussians.opacities >= HAZE_OPACITY)].astype(np.float64))
