"""Boxes of objects and matches where their Gaussians are after edits, or at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...base.arrays import Embedding, Flags, Ids, RowIds, Vector3, WholeNumbers
from ...field.forest import GROUP, Objects
from ...formats.scenes import read_gaussians
from ...kernels.boxes import box_of
from ...query import Match, Scene
from ...query.objects import object_of, objects_of
from ...scene.boxes import solid
from ...scene.gaussians import Gaussians
from ...scene.labelled import LabelledScene, Thing
from ..editing import Duplicate, EditFile, EditList
from ..editing.draft import OBJECT_ID
from ..editing.edits import drafted


@dataclass(frozen=True, eq=False)
class After:
    """The rows of a scene after a list of edits.

    everything: all rows, those that edits added behind the scene's own, removed ones still in it.

    present: which of them are there. copies: per number of an object that an edit made, that of which it is a copy; -1
    for none.
    """

    everything: Gaussians
    present: Flags
    copies: dict[int, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Placing:
    """Places of the boxes of objects and matches after edits.

    registered: the rows that boxes of the field are about. after: where they are now. up: boxes stand along it."""

    registered: Gaussians
    after: After
    up: Vector3 | None

    def objects(self, things: Sequence[Thing]) -> list[Thing]:
        """Return objects with their boxes where they are, those that edits added behind; removed ones stay listed."""
        if not things:
            return list(things)
        placed = [self._placed(thing, self._owned(thing.number)) for thing in things]
        return placed + [self._copy(number, things) for number in sorted(self.after.copies) if len(self._owned(number))]

    def matches(self, matches: Sequence[Match], things: Sequence[Thing]) -> tuple[Thing, ...]:
        """Return the boxes of matches where they are; without those of which nothing is left."""
        left = [match.gaussian_ids[self.after.present[match.gaussian_ids]] for match in matches]
        return tuple(self._placed(thing, ids) for thing, ids in zip(things, left, strict=True) if len(ids))

    def _copy(self, number: int, things: Sequence[Thing]) -> Thing:
        source = next((thing for thing in things if thing.number == self.after.copies[number]), None)
        like = replace(things[0], parent=-1, embedding=None) if source is None else source
        name = f"object {number}" if source is None else f"copy of {source.name}"
        return self._boxed(replace(like, name=name, number=number), self._owned(number))

    def _placed(self, thing: Thing, ids: RowIds) -> Thing:
        return self._boxed(thing, ids) if len(ids) and self._moved[ids].any() else thing

    def _boxed(self, thing: Thing, ids: RowIds) -> Thing:
        everything = self.after.everything
        box = box_of(everything, solid(everything, ids), self.up)
        return replace(thing, center=box.center, axes=box.axes, extent=box.extent)

    @cached_property
    def _moved(self) -> Flags:
        """True for each row that is elsewhere, or otherwise, than it was registered."""
        now, own = self.after.everything, len(self.registered)
        moved = np.ones(len(now), bool)
        if now.means is self.registered.means:
            return ~moved
        pairs = [(getattr(now, name)[:own], getattr(self.registered, name)) for name in ("means", "quats", "scales")]
        moved[:own] = np.any([(one != other).any(1) for one, other in pairs], axis=0)
        return moved

    def _owned(self, number: int) -> RowIds:
        """Return the rows of an object that are there."""
        order, starts = self._by_object
        low, high = np.searchsorted(starts, (number, number + 1))
        return order[low:high]

    @cached_property
    def _by_object(self) -> tuple[RowIds, np.ndarray]:
        """Return the rows that are there in the order of their objects, and these objects."""
        owners = self.after.everything.extra[OBJECT_ID]
        rows = np.flatnonzero(self.after.present & (owners >= 0))
        order = rows[np.argsort(owners[rows], kind="stable")]
        return order, owners[order]


def rows_of(things: Sequence[Thing], numbers: WholeNumbers) -> Ids:
    """Return per Gaussian the place of its object in a list, from its number; -1 for none."""
    places = np.full(max((thing.number for thing in things), default=-1) + 2, -1, np.int32)
    for place, thing in enumerate(things):
        places[thing.number] = place
    return places[np.where((numbers >= 0) & (numbers < len(places) - 1), numbers, -1)]  # the last one is that of -1


def only_used(scene: LabelledScene) -> LabelledScene:
    """Return a scene without objects and groups that it has no Gaussians of, and without annotations outside of it."""
    low, high = scene.gaussians.positions.min(0), scene.gaussians.positions.max(0)
    notes = tuple(one for one in scene.annotations if ((one.center >= low) & (one.center <= high)).all())
    owners = scene.object_of
    used = [] if owners is None else np.unique(owners[owners >= 0]).tolist()
    # the groups that some objects are in, and those that these are in
    found: set[int] = set()
    waiting = [scene.things[place].parent for place in used]
    while waiting:
        group = waiting.pop()
        if group >= 0 and group not in found:
            found.add(group)
            waiting.append(scene.groups[group].parent)
    groups = sorted(found)
    object_of = None if owners is None else _renumbered(used, len(scene.things))[owners]
    to_group = _renumbered(groups, len(scene.groups))
    return replace(
        scene,
        things=tuple(_moved(scene.things[place], to_group) for place in used),
        groups=tuple(_moved(scene.groups[place], to_group) for place in groups),
        object_of=object_of,
        annotations=notes,
    )


def _renumbered(places: Sequence[int], count: int) -> Ids:
    """Return the new place of each of `count` old ones, -1 for those left out; the last one is that of -1."""
    new = np.full(count + 1, -1, np.int32)
    new[list(places)] = np.arange(len(places), dtype=np.int32)
    return new


def _moved(thing: Thing, to_group: Ids) -> Thing:
    return replace(thing, parent=int(to_group[thing.parent]))


def things_of(scene: Scene, embeddings: bool = False) -> list[Thing]:
    """Return the objects of a scene by number, as `drsplat objects` lists them; none where nobody has looked.

    Their names are the labels that people gave, else the words that the encoder is sure of, else "object 7".
    """
    if scene.field.objects is None:
        return []
    objects = objects_of(scene.field)
    place = {node: number for number, node in enumerate(_group_nodes(objects))}
    return [
        Thing(
            match.label or name or f"object {number}",
            match.score,
            match.center,
            match.axes,
            match.extent,
            place.get(int(objects.parents[node]), -1),
            _embedding(objects, node) if embeddings else None,
            number,
        )
        for number, (node, match, name) in enumerate(
            zip(objects.things.tolist(), scene.objects, scene.object_names(), strict=True)
        )
    ]


def groups_of(scene: Scene) -> tuple[Thing, ...]:
    """Return the groups of a scene's objects, which are numbered in the order of their nodes."""
    if scene.field.objects is None:
        return ()
    objects, labels = objects_of(scene.field), scene.labels.by_node
    nodes = _group_nodes(objects)
    place = {node: number for number, node in enumerate(nodes)}
    return tuple(
        Thing(
            labels[node].name if node in labels else f"group {number}",
            float(objects.sure[node]),
            objects.centers[node],
            objects.axes[node],
            objects.extents[node],
            place.get(int(objects.parents[node]), -1),
        )
        for number, node in enumerate(nodes)
    )


def match_thing(scene: Scene, number: int, match: Match) -> Thing:
    """Return a match as a named box: by its label, else by its number and that of its object."""
    owner = object_of(scene.field, match)
    name = f"match {number}" if owner is None else f"match {number}, object {owner}"
    return Thing(match.label or name, match.score, match.center, match.axes, match.extent)


def _group_nodes(objects: Objects) -> Sequence[int]:
    return np.flatnonzero(objects.levels == GROUP).tolist()


def _embedding(objects: Objects, node: int) -> Embedding | None:
    """Return the descriptor of most of an object's masks, None where it has none."""
    found = objects.descriptors_of(node)
    return found[0] if len(found) else None


def after_edits(gaussians: Gaussians, path: Path | None, listed: EditList) -> After:
    """Return a scene after the edits of a list; without any, its own arrays.

    path: of the scene, which other scenes that edits name lie relative to. Raises: as `authoring.editing.edited`.
    """
    if not listed.active:
        return After(gaussians, np.ones(len(gaussians), bool))
    draft = drafted(gaussians, listed.active, read_gaussians if path is None else EditFile.beside(path).other)
    # whose copy each object is that an edit added
    owners, copies = draft.owners, {}
    for edit, (begin, end) in zip(listed.active, draft.added, strict=True):
        if owners is None or begin == end:
            continue
        source = -1
        if isinstance(edit.change, Duplicate):
            own = owners[edit.target.ids(draft)]
            source = int(np.bincount(own[own >= 0], minlength=1).argmax()) if (own >= 0).any() else -1
        copies[int(owners[begin])] = source
    return After(draft.rows, draft.present, copies)
