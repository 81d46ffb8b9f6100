"""Boxes of objects and matches where their Gaussians are after edits, or at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...base.arrays import Bool, Float64, Int64
from ...kernels.boxes import box_of
from ...query import Match
from ...scene.boxes import solid
from ...scene.gaussians import Gaussians
from ...scene.labelled import Thing
from ..editing.draft import OBJECT_ID
from .after import After

Ids = Int64[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class Placing:
    """Places of the boxes of objects and matches after edits.

    registered: the rows that boxes of the field are about. after: where they are now. up: boxes stand along it."""

    registered: Gaussians
    after: After
    up: Float64[np.ndarray, " 3"] | None

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

    def _placed(self, thing: Thing, ids: Ids) -> Thing:
        return self._boxed(thing, ids) if len(ids) and self._moved[ids].any() else thing

    def _boxed(self, thing: Thing, ids: Ids) -> Thing:
        everything = self.after.everything
        box = box_of(everything, solid(everything, ids), self.up)
        return replace(thing, center=box.center, axes=box.axes, extent=box.extent)

    @cached_property
    def _moved(self) -> Bool[np.ndarray, " d"]:
        """True for each row that is elsewhere, or otherwise, than it was registered."""
        now, own = self.after.everything, len(self.registered)
        moved = np.ones(len(now), bool)
        if now.means is self.registered.means:
            return ~moved
        pairs = [(getattr(now, name)[:own], getattr(self.registered, name)) for name in ("means", "quats", "scales")]
        moved[:own] = np.any([(one != other).any(axis=1) for one, other in pairs], axis=0)
        return moved

    def _owned(self, number: int) -> Ids:
        """Return the rows of an object that are there."""
        order, starts = self._by_object
        low, high = np.searchsorted(starts, (number, number + 1))
        return order[low:high]

    @cached_property
    def _by_object(self) -> tuple[Ids, np.ndarray]:
        """Return the rows that are there in the order of their objects, and these objects."""
        owners = self.after.everything.extra[OBJECT_ID]
        rows = np.flatnonzero(self.after.present & (owners >= 0))
        order = rows[np.argsort(owners[rows], kind="stable")]
        return order, owners[order]
