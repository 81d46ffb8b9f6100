"""How a hole was closed by versions 1 to 3 of fills, which lists keep without a record: computed each time."""

from functools import cached_property

import numpy as np

from ...base.arrays import Int64, Integer
from ...formats.runs import spans_of
from .fill_record import Clones
from .ground import COVERED_OPACITY, MIN_STANDING_TOLERANCES, Cells, Ground, Surface, best_shift

MAX_SHIFTS = 8  # that clones are taken by
Ids = Int64[np.ndarray, " m"]


class EarlierGround(Ground):
    """A plane whose objects are those that have much of all that is near."""

    @cached_property
    def main_owners(self) -> Integer[np.ndarray, " o"]:
        return self.owners_of(self.rows)


def closed_as_earlier(
    near: Int64[np.ndarray, " k"], ground: EarlierGround, version: int
) -> tuple[Ids, list[Clones], float]:  # fmt: skip
    """Return which Gaussians near a thing go for a plane, what is cloned, and how much of the hole stays open."""
    coverage = ground.grid.coverage(ground.scene.subset(ground.rows))
    hole = ground.hole_in(coverage)
    if version == 1:
        clones, missing = _clones(
            near, ground, ground.rows, hole, (coverage >= COVERED_OPACITY) & ~hole & ground.bare, None
        )
    else:
        surface = ground.surface(hole)
        clones, missing = _clones(near, ground, ground.own, hole, ground.cloneable(surface.known), surface)
    goes = ground.guessed(hole) if version > 2 else _about(ground, hole)
    return goes, clones, float(missing.sum() / max(1, hole.sum()))


def _clones(
    near: Int64[np.ndarray, " k"], ground: Ground, own: Ids, hole: Cells, good: Cells, surface: Surface | None
) -> tuple[list[Clones], Cells]:  # fmt: skip
    """Return what is cloned, and the cells of the hole that nothing was found for."""
    missing, clones = hole.copy(), []
    for _ in range(MAX_SHIFTS if hole.any() else 0):
        shift, closed = best_shift(missing, good, surface)
        if not closed.any():
            break
        source = np.zeros_like(good)
        down, across = np.nonzero(closed)
        source[down + shift[0], across + shift[1]] = True
        rows = own[ground.grid.among(source, ground.places[own])]
        if len(rows):
            clones.append(Clones(spans_of(near[rows]), -ground.grid.shift(shift)))
        missing &= ~closed
        surface = surface and surface.closed(closed, shift)
    return clones, missing


def _about(ground: Ground, hole: Cells) -> Ids:
    """Return the Gaussians about a plane in a hole of it, whosever they are."""
    low = np.flatnonzero(np.abs(ground.heights) <= MIN_STANDING_TOLERANCES * ground.plane.tolerance)
    return np.asarray(low[ground.grid.among(hole, ground.places[low])])
