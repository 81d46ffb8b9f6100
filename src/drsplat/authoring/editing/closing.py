"""How a hole that a removal leaves is closed: what is cloned from beside it, and what is left open."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from ...base.arrays import Indices, Mask, RowIds
from ...errors import InputError, warn
from ...formats.json_files import spans_of
from ...scene.boxes import HAZE_OPACITY
from .draft import Draft
from .fill_record import Clones, FillRecord
from .ground import Ground, best_shift
from .planes import near_thing, surfaces_around

MAX_SHIFTS = 16  # that clones are taken by
CLOSED_OPACITY = 0.8  # of a cell's clones, from which on the cell is closed
CLONE_MARGIN_CELLS = 2  # around cells that close: Gaussians there reach into them and are cloned too
FOOT_CELLS = 3  # around what stands on a plane: its foot may reach so far into the plane
MIN_VISIBLE_GAUSSIANS = 10  # of an object that can leave a hole
WARNED_CLOSED_SHARE = 0.9  # of a hole: where less is closed, a warning says so
MIN_CLOSED_SHARE = 0.2  # of a hole: with less it stays open, for the fill would be specks
Cells = Mask


def closing(draft: Draft, ids: RowIds) -> FillRecord:
    """Return what a fill does where some rows stood at first.

    Raises: InputError: too few rows to leave a hole, or no plane was found. Warns: DrSplatWarning: a hole that could be
    closed in part only.
    """
    seen = ids[draft.rows.opacities[ids] >= HAZE_OPACITY]
    if len(seen) < MIN_VISIBLE_GAUSSIANS:
        raise InputError(
            f"fill: {len(seen)} Gaussians that can be seen leave no hole: {MIN_VISIBLE_GAUSSIANS} are the fewest"
        )
    thing = draft.homes[seen].astype(np.float64)
    beside = near_thing(draft.rows.means, thing)[0] & draft.present
    beside[ids] = False
    near = np.flatnonzero(beside)
    scene = draft.rows.subset(near)
    around = scene.means[scene.opacities >= HAZE_OPACITY].astype(np.float64)
    planes = surfaces_around(thing, around)
    if not planes:
        raise InputError(
            "fill: no ground and no wall was found beside what was there: it stands free, or nothing flat of "
            "several sides is around it. The hole stays open"
        )
    removed, clones = np.zeros(len(near), bool), list[Clones]()
    for plane in planes:
        behind = [other for other in planes if other is not plane]
        goes, more, open_share = _closed(near, Ground(scene, plane, behind, thing))
        if open_share > 1 - WARNED_CLOSED_SHARE:
            warn(f"fill: of one plane {1 - open_share:.0%} of the hole could be closed", 4)
        removed[goes] = True
        clones += more
    return FillRecord(spans_of(near[removed]), tuple(clones))


def _closed(near: Indices, ground: Ground) -> tuple[RowIds, list[Clones], float]:
    """Return which of the Gaussians near a thing go for a plane, what is cloned, and how much of the hole stays open.

    A hole that the plane is not around, or that hardly anything could close, stays as it is.
    """
    clones, missing = _clones(near, ground) if ground.is_around_hole else ([], ground.hole)
    open_share = missing.sum() / max(1, ground.hole.sum())
    if open_share > 1 - MIN_CLOSED_SHARE:
        return ground.standing, [], 1.0
    return np.union1d(ground.standing, ground.guessed), clones, float(open_share)


def _clones(near: Indices, ground: Ground) -> tuple[list[Clones], Cells]:
    """Return what is cloned, and the cells of the hole that this leaves open."""
    hole, scene, grid, surface = ground.hole, ground.scene, ground.grid, ground.surface
    missing, seen_through = hole, np.ones(grid.shape)
    good = surface.known & ndimage.binary_erosion(ground.bare, iterations=FOOT_CELLS, border_value=1)
    clones = []
    for _ in range(MAX_SHIFTS):
        shift, closed = best_shift(missing, good, surface)
        # the cells by a shift from those that it closes, and some around them
        source = np.zeros_like(closed)
        down, across = np.nonzero(closed)
        source[down + shift[0], across + shift[1]] = True
        rows = ground.own[
            grid.among(ndimage.binary_dilation(source, iterations=CLONE_MARGIN_CELLS), ground.places[ground.own])
        ]
        if not closed.any() or not len(rows):
            break
        clones.append(Clones(spans_of(near[rows]), -grid.shift(shift)))
        means = (scene.means[rows] + clones[-1].by).astype(np.float32)
        seen_through *= 1 - grid.coverage(replace(scene.subset(rows), means=means))
        missing = hole & (seen_through > 1 - CLOSED_OPACITY)
        surface = surface.closed(closed, shift)
    return clones, missing
