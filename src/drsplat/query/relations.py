"""How objects lie to each other: on, in, next to, above, under, between; by boxes and contact, without words for them.

Defined in docs/grouping.md. Functions of Gaussians, matches and the direction that is up.
"""

from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np

from ..base.arrays import Float64
from ..errors import InputError
from ..scene.parted import AnyGaussians
from ..scene.views import View
from .answer import Match
from .spatial import gap, is_over, solid_centers, stands_on

Relation = Literal["on", "in", "next_to", "above", "under", "between"]
RELATIONS: tuple[Relation, ...] = get_args(Relation)
Side = Literal["left_of", "right_of"]
OfTwo = Literal["on", "in", "next_to", "above", "under", "left_of", "right_of"]  # what `Scene.when` takes
SIDES: tuple[Side, ...] = get_args(Side)
Up = Float64[np.ndarray, " 3"]

MIN_INSIDE_SHARE = 0.5  # of an object's Gaussians in the box of what it is in
NUM_SECTORS, MIN_WALLED_SECTORS = 16, 12  # around an object; with a wall of what it is in
MIN_OVER = 8  # Gaussians of what a thing is under, above its middle half
MIN_COMMON_HEIGHT_SHARE = 0.1  # of the lower of two objects next to each other
_Holds = Callable[[AnyGaussians, Match, Match, Up], bool]


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
    if (np.abs(local) <= container.extent / 2).all(axis=1).mean() < MIN_INSIDE_SHARE:
        return False
    foot, head = np.quantile(points @ up, (0.02, 0.98))
    heights = walls @ up
    around = (walls - points.mean(axis=0))[(heights >= foot) & (heights <= head)]
    east = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    angles = np.arctan2(around @ np.cross(up, east), around @ east)
    sectors = np.floor((angles / (2 * np.pi) + 0.5) * NUM_SECTORS).astype(int) % NUM_SECTORS
    return len(np.unique(sectors)) >= MIN_WALLED_SECTORS


def lies_above(gaussians: AnyGaussians, thing: Match, other: Match, up: Up) -> bool:
    """Return True if all of a thing is higher than another, its middle over it, and it does not stand on it."""
    top, foot = (_heights(gaussians, one, up)[end] for one, end in ((other, 1), (thing, 0)))
    over = is_over(solid_centers(gaussians, thing), solid_centers(gaussians, other), up)
    return bool(foot >= top and over and not stands_on(gaussians, thing, other, up))


def lies_under(gaussians: AnyGaussians, thing: Match, other: Match, up: Up) -> bool:
    """Return True if some of another thing is higher than all of a thing and over its middle half."""
    points, over = (solid_centers(gaussians, one) for one in (thing, other))
    flat, middle = np.eye(3) - np.outer(up, up), points.mean(axis=0)
    half = np.quantile(np.linalg.norm((points - middle) @ flat, axis=1), 0.5)
    is_over_it = np.linalg.norm((over - middle) @ flat, axis=1) <= half
    top = _heights(gaussians, thing, up)[1]
    return int((over[is_over_it] @ up > top).sum()) >= MIN_OVER


def lies_next_to(gaussians: AnyGaussians, thing: Match, other: Match, up: Up) -> bool:
    """Return True if two things are beside each other, nearer than the mean of their boxes' longest sides."""
    (low, high), (foot, head) = (_heights(gaussians, one, up) for one in (thing, other))
    shared = min(high, head) - max(low, foot)
    if shared < MIN_COMMON_HEIGHT_SHARE * min(high - low, head - foot):
        return False
    reach = float(thing.extent.max() + other.extent.max()) / 2
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
    return _meets(begin, end - begin, half)


def _meets(begin: Up, way: Up, half: Up) -> bool:
    """Return True if the line from `begin` by `way` meets a box around zero."""
    still = way == 0
    if (np.abs(begin[still]) > half[still]).any():
        return False
    with np.errstate(over="ignore"):
        hits = np.stack([(side * half[~still] - begin[~still]) / way[~still] for side in (-1, 1)])
    entered, left = hits.min(axis=0).max(initial=0), hits.max(axis=0).min(initial=1)
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


_HOLDS: dict[Relation, _Holds] = {
    "on": stands_on, "in": lies_in, "next_to": lies_next_to, "above": lies_above, "under": lies_under,
}  # fmt: skip
