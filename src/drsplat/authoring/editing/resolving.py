"""Rows of what a person names: an object's number, a label, a query; and what hangs on to them."""

import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ...base.arrays import Bool, Flags, Float64, IndexRows, Indices, Integer, OtherFlags, RowIds, WholeNumbers
from ...errors import InputError
from ...field import LanguageField
from ...query import Query, Scene
from ...query.objects import match_of, objects_of
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import Gaussians
from ...scene.morton import morton_order
from .planes import MAX_THING_SHARE_BEHIND, MIN_PLANE_GAUSSIANS, Plane, largest_plane, near_thing, num_sides
from .surrounding import surrounded
from .targets import Rows

DIRECTIONS = 64  # around a place in which the thing is looked for
MIN_INSIDE_SHARE = 0.95  # of an object's Gaussians, for an object inside: the rest may be noise
MIN_SURROUNDED_SHARE = 0.85  # of the directions, for a place inside
MAX_THING_POINTS = 1500  # that directions are computed to
VOTING_NEIGHBOURS = 8  # of a loose Gaussian
MIN_VOTES = 5  # of these, for belonging to the thing
VOTING_PASSES = 2
MIN_FLAT_SHARE = 0.4  # of an object's area above its plane: with so much in the plane it is a floor, a table or a wall
MIN_SIDES = 3  # of eight directions from the thing in which a plane around it must continue
MIN_LIFT_TOLERANCES = 1.3  # above a plane, from which on a Gaussian is not part of it
GRAPH_NEIGHBOURS = 8
SPACING_NEIGHBOUR = 6  # neighbour whose distance counts as the spacing of a thing's Gaussians
MAX_STEP_SPACINGS = 1.5  # of a path between Gaussians, in median spacings of the thing's
MAX_SIZE_QUANTILE = 0.95  # of a thing's Gaussians: larger ones reach beyond it
Owners = Indices
Agreed = Bool[np.ndarray, " o"]  # of each object
Thing = Float64[np.ndarray, "t 3"]
Points = Float64[np.ndarray, "p 3"]


def object_rows(scene: Scene, number: int) -> Rows:
    """Return the rows of an object of the field. Raises: InputError: no such number, or a field without objects."""
    match = match_of(scene.field, objects_of(scene.field).thing(number))
    return Rows.of(complete_rows(scene, match.gaussian_ids), "object", str(number))


def label_rows(scene: Scene, name: str) -> Rows:
    """Return the rows of all that people gave this name. Raises: InputError: nothing has it."""
    nodes = scene.labels.called(name)
    if not nodes:
        known = ", ".join(sorted({label.name for label in scene.labels.by_node.values()})) or "none"
        raise InputError(f"nothing has the label '{name}'; labels here: {known}")
    ids = np.concatenate([match_of(scene.field, node).gaussian_ids for node in nodes])
    return Rows.of(complete_rows(scene, ids), "label", name)


def query_rows(scene: Scene, query: Query | str, words: str = "") -> Rows:
    """Return the rows of all matches of a query together. Raises: InputError: it has none."""
    words = words or (query if isinstance(query, str) else query.text or "")
    answer = scene.ask(query).without_maybe()
    matches = scene.locate(answer)
    if not matches:
        raise InputError(f"no match for “{words}”: `drsplat locate` prints how near it was")
    ids = np.concatenate([match.gaussian_ids for match in matches])
    return Rows.of(complete_rows(scene, ids, answer.field), "query", words)


def complete_rows(scene: Scene, ids: WholeNumbers, field: LanguageField | None = None) -> RowIds:
    """Return rows of a scene with what nobody can tell apart from them; see `completed`. field: None for its own."""
    owners, agreed = np.full(len(scene.gaussians), -1, np.int64), np.zeros(0, bool)
    if (scene.field if field is None else field).objects is not None:
        owners, agreed = scene.object_ids().astype(np.int64), scene.agreed
    return completed(scene.gaussians, ids, owners, agreed, threads=scene.threads)


def completed(
    gaussians: Gaussians, ids: Integer[np.ndarray, " k"], owners: Owners, agreed: Agreed, *, threads: int = 0
) -> RowIds:
    """Return rows with what cannot be told apart from them.

    That is the rest of objects that they nearly are, what they enclose, loose Gaussians that hang on to them, and in a
    scene with objects `loose_parts` and `rests`.

    Training leaves Gaussians inside of things, where no photo looks; masks give them to whatever is behind. What is
    inside stays behind only where it is more than half of an object: an apple in a closed box.
    """
    inside = np.zeros(len(gaussians), bool)
    inside[ids] = True
    owned = owners >= 0
    sizes = np.bincount(owners[owned], minlength=owners.max(initial=0) + 1)
    nearly_all = np.bincount(owners[inside & owned], minlength=len(sizes)) >= MIN_INSIDE_SHARE * sizes
    inside |= owned & nearly_all[owners]
    taken = enclosed(gaussians, inside)
    own_things = np.bincount(owners[taken & owned], minlength=len(sizes)) > sizes / 2
    inside |= taken & ~(own_things[owners] & owned)
    inside = hanging(gaussians, inside, owners < 0, threads)
    if len(agreed):
        inside |= loose_parts(gaussians, inside, owners, agreed, threads)
        inside |= rests(inside, owners, agreed)
    return np.flatnonzero(inside)


def rests(inside: Flags, owners: Owners, agreed: Agreed) -> Flags:
    """Return the Gaussians of objects that photos do not agree on and of which a thing has more than half."""
    owned = owners >= 0
    sizes, own = (np.bincount(owners[some], minlength=len(agreed)) for some in (owned, owned & inside))
    return owned & ((2 * own > sizes) & ~agreed)[owners]


def enclosed(gaussians: Gaussians, inside: Flags) -> Flags:
    """Return other Gaussians that have those of a thing around them in nearly all directions."""
    thing = gaussians.means[inside & (gaussians.opacities >= HAZE_OPACITY)].astype(np.float64)
    found = np.zeros(len(gaussians), bool)
    if len(thing) < DIRECTIONS:
        return found
    thing = thing[:: -(-len(thing) // MAX_THING_POINTS)]
    low, high = np.quantile(thing, (0.01, 0.99), axis=0)
    near = np.flatnonzero(((gaussians.means > low) & (gaussians.means < high)).all(1) & ~inside)
    places = gaussians.means[near].astype(np.float64)
    found[near] = surrounded(places, thing, _sphere(DIRECTIONS), math.ceil(MIN_SURROUNDED_SHARE * DIRECTIONS))
    return found


def hanging(gaussians: Gaussians, inside: OtherFlags, loose: OtherFlags, threads: int = 0) -> OtherFlags:
    """Return a thing with the loose Gaussians most of whose neighbours belong to it, `VOTING_PASSES` times."""
    inside, tree = inside.copy(), None
    neighbours: IndexRows = np.empty((0, min(VOTING_NEIGHBOURS + 1, len(gaussians))), np.int64)
    place = np.full(len(gaussians), -1)  # of each Gaussian among them
    for _ in range(VOTING_PASSES):
        thing = gaussians.means[inside]
        low, high = thing.min(0, initial=np.inf), thing.max(0, initial=-np.inf)
        within = ((gaussians.means >= low) & (gaussians.means <= high)).all(1)
        near = np.flatnonzero(within & loose & ~inside)
        new = near[place[near] < 0]
        if len(new):
            new = new[morton_order(gaussians.means[new])]  # queries of neighbours, one after another, are fast
            tree = tree or cKDTree(gaussians.means)
            place[new] = np.arange(len(new)) + len(neighbours)
            ranks = range(1, neighbours.shape[1] + 1)
            found = tree.query(gaussians.means[new], ranks, workers=threads or -1)[1]
            neighbours = np.concatenate([neighbours, found])
        inside[near] = inside[neighbours[place[near]]].sum(1) >= MIN_VOTES
    return inside


def _sphere(count: int) -> Points:
    """Return directions evenly spread, along a spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def loose_parts(gaussians: Gaussians, inside: Flags, owners: Owners, agreed: Agreed, threads: int = 0) -> Flags:
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
    thing = gaussians.means[inside & (gaussians.opacities >= HAZE_OPACITY)].astype(np.float64)
    if len(thing) < MIN_PLANE_GAUSSIANS:
        return np.zeros_like(inside)
    near, size = near_thing(gaussians.means, thing)
    others = near & ~inside & (owners >= 0)
    others[others] = agreed[owners[others]]
    standing, places = near & ~inside, gaussians.means[near].astype(np.float64)
    for number, plane in _grounds(gaussians, owners, others, ~inside, thing, size):
        others &= owners != number
        standing[near] &= plane.heights(places) > MIN_LIFT_TOLERANCES * plane.tolerance
    sizes = gaussians.scales.max(1)
    small = sizes <= np.quantile(sizes[inside], MAX_SIZE_QUANTILE)
    return _nearest_along_paths(gaussians, inside & near, others & standing, standing & ~others & small, threads)


def _grounds(
    gaussians: Gaussians, owners: Owners, near: Flags, rest: Flags, thing: Thing, size: float
) -> Iterator[tuple[int, Plane]]:
    """Yield the numbers and planes of objects that a thing stands on or before, as a whole or near it: floor, wall.

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
            yield number, plane


def _plane_of(
    gaussians: Gaussians, rows: Flags, thing: Thing, is_wide: Callable[[Points, Plane], bool]
) -> Plane | None:
    """Return the plane that most of some Gaussians' area is in, None where there is none or the thing is behind it.

    What lies behind it does not count: below a glossy table training leaves what it mirrors.
    """
    rows = rows & (gaussians.opacities >= HAZE_OPACITY)
    points = gaussians.means[rows].astype(np.float64)
    plane = largest_plane(points, thing) if len(points) >= MIN_PLANE_GAUSSIANS else None
    if plane is None:
        return None
    areas = np.sort(gaussians.scales[rows].astype(np.float64), axis=1)[:, 1:].prod(1) * gaussians.opacities[rows]
    heights = plane.heights(points)
    is_flat = areas[plane.holds(points)].sum() >= MIN_FLAT_SHARE * areas[heights >= -plane.tolerance].sum()
    is_before = float((plane.heights(thing) < -plane.tolerance).mean()) <= MAX_THING_SHARE_BEHIND
    return plane if is_flat and is_before and is_wide(points[plane.holds(points)], plane) else None


def _nearest_along_paths(gaussians: Gaussians, inside: Flags, others: Flags, loose: Flags, threads: int) -> Flags:
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
