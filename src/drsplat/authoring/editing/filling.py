"""The hole that a removal leaves: ground and wall Gaussians cloned from beside it, along their plane."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ...base.arrays import Bool, Float64, Int64
from ...errors import DrSplatWarning, InputError
from ...formats.runs import spans_of
from ...scene.boxes import HAZE_OPACITY
from .draft import Draft
from .earlier_fills import EarlierGround, closed_as_earlier
from .fill_record import Clones, FillRecord
from .ground import Ground
from .planes import planes_around, surfaces_around
from .shifts import best_shift

SEARCH_MARGIN_SHARE = 0.8  # of the object's size: how far around it planes are fitted and clones are taken
MAX_SHIFTS = 16  # that clones are taken by
CLOSED_OPACITY = 0.8  # of a cell's clones, from which on the cell is closed
CLONE_MARGIN_CELLS = 2  # around cells that close: Gaussians there reach into them and are cloned too
MIN_VISIBLE_GAUSSIANS = 10  # of an object that can leave a hole
WARNED_CLOSED_SHARE = 0.9  # of a hole: where less is closed, a warning says so
MIN_CLOSED_SHARE = 0.2  # of a hole: with less it stays open, for the fill would be specks
VERSIONS = (1, 2, 3, 4)
FIRST_RECORDED_VERSION = 4  # edits from this version on are stored with their result
Ids = Int64[np.ndarray, " m"]
Cells = Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class Fill:
    """Change that clones what is missing where rows stood at first from the planes that they stood on or before.

    A table goes on below a vase, a floor and a wall behind a shelf; what training left there unseen goes. Nothing is
    made up: no edge, no pattern with a place of its own; shadows and reflections stay, and what no plane holds is open.

    version: 2 clones nothing that lies on the plane or stands out from it, and by the shift with the best seam; 3 also
    lets other things in the hole be, such as what stands below a table; 4 closes more of the hole, leaves no specks
    where it can close little, takes what stands off the plane in the thing's place, and is stored with its record; 1 is
    what lists of edits without a version mean, and does none of it.

    record: what it does, None where that is still to be computed, from the scene and the objects at hand.

    Raises: InputError: another version, or a record of an earlier one.
    """

    version: int = VERSIONS[-1]
    record: FillRecord | None = None

    def __post_init__(self) -> None:
        if self.version not in VERSIONS:
            raise InputError(f"fill: expected version 1 to 4, got {self.version}: a newer drsplat may know it")
        if self.record is not None and self.version < FIRST_RECORDED_VERSION:
            raise InputError(f"fill: version {self.version} has no record: leave it out, or give version 4")

    @property
    def lacks_record(self) -> bool:
        """True if this version is stored with a record, and there is none yet."""
        return self.record is None and self.version >= FIRST_RECORDED_VERSION

    def apply(self, draft: Draft, ids: Ids) -> None:
        """Close the hole that the target leaves. Raises: InputError: as `recorded`, or a record that does not fit."""
        (self.record or self._computed(draft, ids)).apply(draft)

    def recorded(self, draft: Draft, ids: Ids) -> "Fill":
        """Return this change with the record of what it does to a draft, which stays as it is.

        Raises: InputError: too few rows to leave a hole, or no plane was found. Warns: DrSplatWarning: a hole that
        could be closed in part only.
        """
        return replace(self, record=self._computed(draft, ids))

    def _computed(self, draft: Draft, ids: Ids) -> FillRecord:
        seen = ids[draft.opacities[ids] >= HAZE_OPACITY]
        if len(seen) < MIN_VISIBLE_GAUSSIANS:
            raise InputError(
                f"fill: {len(seen)} Gaussians that can be seen leave no hole: {MIN_VISIBLE_GAUSSIANS} are the fewest"
            )
        thing = draft.homes[seen].astype(np.float64)
        near = _near(draft, ids, thing)
        scene = draft.part(near)
        around = scene.means[scene.opacities >= HAZE_OPACITY].astype(np.float64)
        early = self.version < FIRST_RECORDED_VERSION
        planes = (planes_around if early else surfaces_around)(thing, around)
        if not planes:
            raise InputError(
                "fill: no ground and no wall was found beside what was there: it stands free, or nothing flat of "
                "several sides is around it. The hole stays open"
            )
        removed, clones = np.zeros(len(near), bool), list[Clones]()
        for plane in planes:
            sight = scene, plane, [other for other in planes if other is not plane], thing
            goes, more, open_share = (
                closed_as_earlier(near, EarlierGround(*sight), self.version) if early else _closed(near, Ground(*sight))
            )
            _tell(open_share)
            removed[goes] = True
            clones += more
        return FillRecord(spans_of(near[removed]), tuple(clones))


def _near(draft: Draft, ids: Ids, thing: Float64[np.ndarray, "t 3"]) -> Int64[np.ndarray, " k"]:
    """Return the rows that are there around what stood there, without itself."""
    low, high = np.quantile(thing, (0.01, 0.99), axis=0)
    reach = SEARCH_MARGIN_SHARE * float(np.linalg.norm(high - low))
    near = ((draft.means >= low - reach) & (draft.means <= high + reach)).all(axis=1) & draft.present
    near[ids] = False
    return np.flatnonzero(near)


def _closed(near: Int64[np.ndarray, " k"], ground: Ground) -> tuple[Ids, list[Clones], float]:
    """Return which of the Gaussians near a thing go for a plane, what is cloned, and how much of the hole stays open.

    A hole that the plane is not around, or that hardly anything could close, stays as it is.
    """
    clones, missing = _clones(near, ground) if ground.is_around_hole else ([], ground.hole)
    open_share = missing.sum() / max(1, ground.hole.sum())
    if open_share > 1 - MIN_CLOSED_SHARE:
        return ground.standing, [], 1.0
    return np.union1d(ground.standing, ground.guessed(ground.hole)), clones, float(open_share)


def _clones(near: Int64[np.ndarray, " k"], ground: Ground) -> tuple[list[Clones], Cells]:
    """Return what is cloned, and the cells of the hole that this leaves open."""
    hole, scene, grid = ground.hole, ground.scene, ground.grid
    surface = ground.surface(hole)
    good, missing, seen_through = ground.cloneable(surface.known), hole, np.ones(grid.shape)
    clones = []
    for _ in range(MAX_SHIFTS):
        shift, closed = best_shift(missing, good, surface)
        rows = ground.own[grid.among(_margin(closed, shift), ground.places[ground.own])]
        if not closed.any() or not len(rows):
            break
        clones.append(Clones(spans_of(near[rows]), -grid.shift(shift)))
        means = (scene.means[rows] + clones[-1].by).astype(np.float32)
        seen_through *= 1 - grid.coverage(replace(scene.subset(rows), means=means))
        missing = hole & (seen_through > 1 - CLOSED_OPACITY)
        surface = surface.closed(closed, shift)
    return clones, missing


def _margin(closed: Cells, shift: tuple[int, int]) -> Cells:
    """Return the cells by a shift from those that it closes, and some around them."""
    source = np.zeros_like(closed)
    down, across = np.nonzero(closed)
    source[down + shift[0], across + shift[1]] = True
    return np.asarray(ndimage.binary_dilation(source, iterations=CLONE_MARGIN_CELLS))


def _tell(open_share: float) -> None:
    """Warn where much of a hole stays open."""
    if open_share > 1 - WARNED_CLOSED_SHARE:
        told = f"fill: of one plane {1 - open_share:.0%} of the hole could be closed"
        warnings.warn(told, DrSplatWarning, stacklevel=4)
