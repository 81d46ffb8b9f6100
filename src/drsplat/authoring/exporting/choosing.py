"""Parts of a labelled scene: the objects, groups and annotations that belong to the Gaussians in it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...base.arrays import Int32, Integer
from ...scene.labelled import LabelledScene, Thing


def rows_of(things: Sequence[Thing], numbers: Integer[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
    """Return per Gaussian the place of its object in a list, from its number; -1 for none."""
    places = np.full(max((thing.number for thing in things), default=-1) + 2, -1, np.int32)
    for place, thing in enumerate(things):
        places[thing.number] = place
    return places[np.where((numbers >= 0) & (numbers < len(places) - 1), numbers, -1)]  # the last one is that of -1


def only_used(scene: LabelledScene) -> LabelledScene:
    """Return a scene without objects and groups that it has no Gaussians of, and without annotations outside of it."""
    low, high = scene.gaussians.positions.min(axis=0), scene.gaussians.positions.max(axis=0)
    notes = tuple(one for one in scene.annotations if ((one.center >= low) & (one.center <= high)).all())
    owners = scene.object_of
    used = [] if owners is None else np.unique(owners[owners >= 0]).tolist()
    groups = _above(scene, used)
    object_of = None if owners is None else _renumbered(used, len(scene.things))[owners]
    to_group = _renumbered(groups, len(scene.groups))
    return replace(
        scene,
        things=tuple(_moved(scene.things[place], to_group) for place in used),
        groups=tuple(_moved(scene.groups[place], to_group) for place in groups),
        object_of=object_of,
        annotations=notes,
    )


def _above(scene: LabelledScene, used: Sequence[int]) -> list[int]:
    """Return the groups that some objects are in, and those that these are in."""
    found: set[int] = set()
    waiting = [scene.things[place].parent for place in used]
    while waiting:
        group = waiting.pop()
        if group >= 0 and group not in found:
            found.add(group)
            waiting.append(scene.groups[group].parent)
    return sorted(found)


def _renumbered(places: Sequence[int], count: int) -> Int32[np.ndarray, " c"]:
    """Return the new place of each of `count` old ones, -1 for those left out; the last one is that of -1."""
    new = np.full(count + 1, -1, np.int32)
    new[list(places)] = np.arange(len(places), dtype=np.int32)
    return new


def _moved(thing: Thing, to_group: Int32[np.ndarray, " c"]) -> Thing:
    return replace(thing, parent=int(to_group[thing.parent]))
