"""How objects lie to each other: on, in, next to, above, under, between; by boxes and contact, without words for them.

Defined in docs/grouping.md. Functions of Gaussians, matches and the direction that is up.

Boxes overlap, or hover by the thickness of a splat, and photos see little of what lies under a thing. Both say little
of whether it stands there; Gaussians beside its foot do: one thing rests on another whose Gaussians its lower ones
touch, around or under its middle. Defined in docs/grouping.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Array, Doubles, Float64, Integer, Vector3
from ..errors import InputError
from ..scene.boxes import solid
from ..scene.parted import AnyGaussians
from ..scene.views import View
from .answer import Match
from .query import Query
from .tasks import meant_of

if TYPE_CHECKING:
    from .scene import Scene

Relation = Literal["on", "in", "next_to", "above", "under", "between"]
RELATIONS: tuple[Relation, ...] = get_args(Relation)
Side = Literal["left_of", "right_of"]
OfTwo = Literal["on", "in", "next_to", "above", "under", "left_of", "right_of"]  # what `Scene.when` takes
SIDES: tuple[Side, ...] = get_args(Side)
Up = Vector3

MIN_INSIDE_SHARE = 0.5  # of an object's Gaussians in the box of what it is in
NUM_SECTORS, MIN_WALLED_SECTORS = 16, 12  # around an object; with a wall of what it is in
MIN_OVER = 8  # Gaussians of what a thing is under, above its middle half
MIN_BELOW, DEEPEST_SHARE = 3, 0.5  # Gaussians below a thing's middle half, no deeper than this share of its height
MIN_COMMON_HEIGHT_SHARE = 0.1  # of the lower of two objects next to each other
_Holds = Callable[[AnyGaussians, Match, Match, Up], bool]
UPRIGHT_COSINE = 0.99  # of a box's third axis with up
MAX_OVERHANG_SHARE = 0.05  # of a thing's size, that its middle may stand out of what it is over
FOOT_SHARE = 0.1  # of a thing's height above its lower side: what can touch; of flat things a typical spacing
TOUCHING_DEVIATIONS = 2.0  # of two Gaussians, towards each other
NUM_NEIGHBOURS = 8
SPACING_NEIGHBOUR = 3  # whose median distance is the typical spacing
MIN_TOUCHING_SHARE = 0.1  # of the foot's Gaussians
MAX_ENCLOSED_GAP_RADIANS = np.pi  # without contact around what cannot fall off
MAX_ONE_SIDED_GAP_RADIANS = 4 / 3 * np.pi  # the same where only the foot touches: photos see one side of a shelf

Points = Float64[np.ndarray, "_ 3"]
Ids = Integer[np.ndarray, " _"]


def related(
    gaussians: AnyGaussians,
    relation: Relation,
    objects: Sequence[Match],
    to: Match,
    and_to: Match | None = None,
    up: Up | None = None,
) -> list[Match]:
    """Return the objects that stand in a relation to one, or are between two; these themselves left out.

    Raises: InputError: two for "between" and one for all others were expected, or nobody knows what is up.
    """
    if (relation == "between") != (and_to is not None):
        raise InputError(
            f"{relation}: expected {'two objects' if relation == 'between' else 'one object'} to relate to"
        )
    ends = [to] if and_to is None else [to, and_to]
    others = [one for one in objects if not any(_same(one, end) for end in ends)]
    if up is None:
        raise InputError("the photos of this scene do not tell which way is up, which these relations need")
    if and_to is not None:
        return [one for one in others if lies_between(gaussians, one, to, and_to, up)]
    return [one for one in others if _HOLDS[relation](gaussians, one, to, up)]


def is_beside(view: View, side: Side, thing: Match, other: Match) -> bool:
    """Return True if a thing's centre is left, or right, of another's in a picture, both before the camera."""
    pose = view.cam_from_world
    one, two = (pose[:3, :3] @ each.center + pose[:3, 3] for each in (thing, other))
    if min(one[2], two[2]) <= 0:
        return False
    left, right = (one, two) if side == "left_of" else (two, one)
    return bool(left[0] / left[2] < right[0] / right[2])


def lies_in(gaussians: AnyGaussians, thing: Match, container: Match, up: Up) -> bool:
    """Return True if half of a thing is in the box of a larger one that has walls around it at its own heights."""
    points, walls = (solid_centers(gaussians, one) for one in (thing, container))
    if np.linalg.norm(thing.extent) >= np.linalg.norm(container.extent):
        return False
    local = (points - container.center) @ container.axes.T
    if (np.abs(local) <= container.extent / 2).all(1).mean() < MIN_INSIDE_SHARE:
        return False
    foot, head = np.quantile(points @ up, (0.02, 0.98))
    heights = walls @ up
    around = (walls - points.mean(0))[(heights >= foot) & (heights <= head)]
    sectors = np.floor((_bearings(around, up) / (2 * np.pi) + 0.5) * NUM_SECTORS).astype(int) % NUM_SECTORS
    return len(np.unique(sectors)) >= MIN_WALLED_SECTORS


def lies_above(gaussians: AnyGaussians, thing: Match, other: Match, up: Up) -> bool:
    """Return True if all of a thing is higher than another, its middle over it, and it does not stand on it."""
    top, foot = (_heights(gaussians, one, up)[end] for one, end in ((other, 1), (thing, 0)))
    over = is_over(solid_centers(gaussians, thing), solid_centers(gaussians, other), up)
    return bool(foot >= top and over and not stands_on(gaussians, thing, other, up))


def lies_under(gaussians: AnyGaussians, thing: Match, other: Match, up: Up) -> bool:
    """Return True if some of another thing is higher than all of a thing and over its middle half."""
    points, over = (solid_centers(gaussians, one) for one in (thing, other))
    top = _heights(gaussians, thing, up)[1]
    return int((_in_column(points, over, up) > top).sum()) >= MIN_OVER


def _in_column(points: Points, others: Points, up: Up) -> Doubles:
    """Return the heights of those others that are above or below the middle half of some points."""
    flat, middle = np.eye(3) - np.outer(up, up), points.mean(0)
    half = np.quantile(np.linalg.norm((points - middle) @ flat, axis=1), 0.5)
    return others[np.linalg.norm((others - middle) @ flat, axis=1) <= half] @ up


def lies_next_to(gaussians: AnyGaussians, thing: Match, other: Match, up: Up) -> bool:
    """Return True if two things are beside each other, nearer than the mean of their boxes' longest sides.

    Gaussians stand for surfaces that go on beyond their centres: a mean typical spacing is added.
    """
    (low, high), (foot, head) = (_heights(gaussians, one, up) for one in (thing, other))
    shared = min(high, head) - max(low, foot)
    if shared < MIN_COMMON_HEIGHT_SHARE * min(high - low, head - foot):
        return False
    sizes = (each.extent.max() + _spacing(solid_centers(gaussians, each)) for each in (thing, other))
    reach = float(sum(sizes)) / 2
    apart = not any(
        holds(gaussians, *pair, up) for holds in (stands_on, lies_in) for pair in ((thing, other), (other, thing))
    )
    return apart and gap(gaussians, thing, other) <= reach


def lies_between(gaussians: AnyGaussians, thing: Match, one: Match, other: Match, up: Up) -> bool:
    """Return True if the line from centre to centre crosses a thing's box from above, and neither centre is over it.

    The thing has to share heights with the two, from the lower side of the lower one to the upper of the higher.
    """
    (low, high), *ends = (_heights(gaussians, each, up) for each in (thing, one, other))
    if low > max(head for _, head in ends) or high < min(foot for foot, _ in ends):
        return False
    offsets = (each.center - thing.center for each in (one, other))
    begin, end = ((offset - (offset @ up) * up) @ thing.axes.T for offset in offsets)
    half = thing.extent / 2
    if (np.abs(begin) <= half).all() or (np.abs(end) <= half).all():
        return False
    # whether the line from `begin` by `way` meets a box around zero
    way = end - begin
    still = way == 0
    if (np.abs(begin[still]) > half[still]).any():
        return False
    with np.errstate(over="ignore"):
        hits = np.stack([(side * half[~still] - begin[~still]) / way[~still] for side in (-1, 1)])
    entered, left = hits.min(0).max(initial=0), hits.max(0).min(initial=1)
    return bool(entered <= left)


def _heights(gaussians: AnyGaussians, thing: Match, up: Up) -> tuple[float, float]:
    """Return the heights of a thing's lower and upper side."""
    low, high = np.quantile(solid_centers(gaussians, thing) @ up, (0.02, 0.98))
    return float(low), float(high)


def _same(one: Match, other: Match) -> bool:
    """Return whether two are the same, also of a match that a query found and that is an object in part."""
    if one.object_id is not None and one.object_id == other.object_id:
        return True
    common = np.isin(one.gaussian_ids, other.gaussian_ids, assume_unique=True).sum()
    return bool(common > 0.5 * min(len(one), len(other)))


def gap(gaussians: AnyGaussians, one: Match, other: Match) -> float:
    """Return the distance between the nearest solid Gaussians of two things, centre to centre, in scene units."""
    first, second = solid_centers(gaussians, one), solid_centers(gaussians, other)
    small, large = (first, second) if len(first) < len(second) else (second, first)
    return float(cKDTree(large).query(small)[0].min())


def standing_on(scene: Scene, matches: Sequence[Match], query: Query | str) -> list[Match]:
    """Return the matches that stand on a sure match of a query.

    Raises: InputError: nothing is called so, or the photos do not tell which way is up.
    """
    supports = meant_of(scene.locate(query), scene.rows)
    if not supports:
        text = query if isinstance(query, str) else query.text or ""
        raise InputError(f"no match for '{text[:60]}', so nothing can stand on it")
    gaussians, up = scene.rows, scene.up
    if up is None:
        raise InputError("the photos of this scene do not tell which way is up: query without 'on'")
    return [one for one in matches if any(stands_on(gaussians, one, support, up) for support in supports)]


def stands_on(gaussians: AnyGaussians, thing: Match, support: Match, up: Vector3) -> bool:
    """Return whether a thing rests on another one, by contact of their Gaussians; see `contact.rests_on`."""
    away = np.abs(support.axes[:2] @ (thing.center - support.center))
    inside = abs(float(support.axes[2] @ up)) > UPRIGHT_COSINE and bool((away <= support.extent[:2] / 2).all())
    return rests_on(gaussians, thing.gaussian_ids, support.gaussian_ids, up, inside)


def is_over(above: Float64[Array, "m 3"], below: Float64[Array, "n 3"], up: Vector3) -> bool:
    """Return True if the middle of some points is over others, seen from above: within a twentieth of their size."""
    flat = np.eye(3) - np.outer(up, up)
    size = float(np.linalg.norm(np.ptp(below @ flat, axis=0)))
    distance = cKDTree(below @ flat).query(above.mean(0) @ flat)[0]
    return bool(distance <= MAX_OVERHANG_SHARE * size)


def solid_centers(gaussians: AnyGaussians, thing: Match) -> Float64[Array, "n 3"]:
    """Return the centres of what can be seen of a thing."""
    return gaussians.shapes_of(solid(gaussians, thing.gaussian_ids)).positions


def rests_on(gaussians: AnyGaussians, thing: Ids, support: Ids, up: Up, inside: bool = False) -> bool:
    """Return whether some Gaussians rest on others, by contact.

    Args:
        gaussians: the scene.
        thing: rows of what may rest; those that can be seen count, here and of the support.
        support: rows of what it may rest on; those that it shares do not count, so that nothing is on itself.
        up: the unit direction that is up.
        inside: whether its middle is in the box of the support, seen from above. Then it also rests on what goes on
            right below its middle, as a book does that leans in a shelf.
    """
    own, others = solid(gaussians, thing), solid(gaussians, np.setdiff1d(support, thing))
    here, there = (_centers(gaussians, ids) for ids in (own, others))
    heights = here @ up
    low, high = np.quantile(heights, (0.02, 0.98))
    ankle = low + max(FOOT_SHARE * (high - low), min(_spacing(here), (high - low) / 2))
    foot = heights <= ankle
    touching, touched = contacts(gaussians, own, own[foot], others)
    if len(touching) < max(MIN_TOUCHING_SHARE * foot.sum(), 1) or np.quantile(there @ up, 0.02) > ankle:
        return False
    places = _centers(gaussians, touched)
    if not is_over(here, there, up) or heights.mean() <= (places @ up).mean():
        return False
    if inside:
        below = _in_column(here, there, up)
        if ((below <= ankle) & (below >= low - DEEPEST_SHARE * (high - low))).sum() >= MIN_BELOW:
            return True
    gap = widest_gap(places, here[foot].mean(0), up)
    if MAX_ENCLOSED_GAP_RADIANS < gap <= MAX_ONE_SIDED_GAP_RADIANS:
        beside = contacts(gaussians, own, own[~foot], others)[1]
        return not len(beside) or bool((_centers(gaussians, beside) @ up).mean() <= ankle)
    return gap <= MAX_ENCLOSED_GAP_RADIANS


def contacts(gaussians: AnyGaussians, thing: Ids, part: Ids, others: Ids) -> tuple[Ids, Ids]:
    """Return those rows of a part of a thing that touch others, and those of the others that they touch, each once.

    Two touch where their centres are no further apart than two standard deviations of both, along the line between
    them, and the mean of the typical spacings of the thing and of the others there. Of each, the eight nearest others
    are looked at. Things of so few Gaussians that they have no spacing touch nothing.
    """
    here, there = (_centers(gaussians, ids) for ids in (part, others))
    if len(part):  # what is farther away than half of the part's diagonal is not looked at
        low, high = here.min(0), here.max(0)
        margin = float(np.linalg.norm(high - low)) / 2
        near = ((there >= low - margin) & (there <= high + margin)).all(1)
        others, there = others[near], there[near]
    if min(len(others), len(thing)) <= SPACING_NEIGHBOUR or not len(part):
        return part[:0], others[:0]
    spacing = (_spacing(_centers(gaussians, thing)) + _spacing(there)) / 2
    distances, nearest = cKDTree(there).query(here, np.arange(1, min(NUM_NEIGHBOURS, len(others)) + 1))
    first, second = np.repeat(part, nearest.shape[1]), others[nearest.ravel()]
    along = there[nearest.ravel()] - np.repeat(here, nearest.shape[1], axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    deviations = _deviations(gaussians, first, along) + _deviations(gaussians, second, along)
    touch = distances.ravel() <= TOUCHING_DEVIATIONS * deviations + spacing
    return np.unique(first[touch]), np.unique(second[touch])


def widest_gap(places: Points, middle: Up, up: Up) -> float:
    """Return the widest angle, seen from above, in which none of some places lies around a middle, in radians."""
    angles = np.sort(_bearings(places - middle, up))
    return float(np.diff(np.append(angles, angles[0] + 2 * np.pi)).max())


def _bearings(offsets: Points, up: Up) -> Doubles:
    """Return the angles, seen from above, at which some offsets point."""
    east = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    return np.asarray(np.arctan2(offsets @ np.cross(up, east), offsets @ east))


def _centers(gaussians: AnyGaussians, ids: Ids) -> Points:
    return gaussians.shapes_of(ids).positions


def _spacing(points: Points) -> float:
    """Return the typical distance to a near neighbour, 0 of points that are too few to have one."""
    if len(points) <= SPACING_NEIGHBOUR:
        return 0.0
    return float(np.median(cKDTree(points).query(points, SPACING_NEIGHBOUR + 1)[0][:, -1]))


def _deviations(gaussians: AnyGaussians, ids: Ids, directions: Points) -> Doubles:
    """Return the standard deviation of each Gaussian along a unit direction of its own."""
    covariances = gaussians.shapes_of(ids).covariances().astype(np.float64)
    a, b = np.triu_indices(3)
    factors = np.where(a == b, 1.0, 2.0) * directions[:, a] * directions[:, b]
    return np.sqrt(np.maximum((covariances * factors).sum(1), 0))


_HOLDS: dict[Relation, _Holds] = {
    "on": stands_on, "in": lies_in, "next_to": lies_next_to, "above": lies_above, "under": lies_under,
}  # fmt: skip
