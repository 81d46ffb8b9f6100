"""The hole that a removal leaves: ground and wall Gaussians cloned from beside it, along their plane."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ...base.arrays import Bool, Float64, Int64
from ...drawing.rendering import Picture, render
from ...errors import DrSplatWarning, InputError
from ...formats.runs import spans_of
from ...scene.boxes import HAZE
from ...scene.gaussians import SH_C0, Gaussians
from ...scene.views import View
from .draft import OBJECT_ID, Draft
from .fill_record import Clones, FillRecord
from .planes import Plane, planes_around
from .shifts import Surface, best_shift

AROUND = 0.8  # sizes of the object: how far around it planes are looked for, and clones are taken from
CELLS = 128  # of the longer side of what is looked at
COVERED = 0.6  # opacity of a plane that hides what is behind it
ROUNDS = 8  # shifts that clones are taken by
FEWEST = 10  # Gaussians that can be seen, of something that can leave a hole
ENOUGH = 0.9  # of a hole: less is told
FOOT = 0.15  # of an object's height, from its lowest on: below that no photo saw the ground, and training guessed
STANDS = 1.3  # tolerances above a plane from which on something stands on it
CLEAR = 0.2  # opacity of what stands on a plane up to which it is taken to be bare
NEEDLE = 6.0  # times longer than wide: no patch of a surface
FOOT_CELLS = 3  # around what stands on a plane, where its foot may lie in the plane
LEAST_SHARE = 0.2  # of the Gaussians in a plane, of an object that the plane is part of
VERSIONS = (1, 2, 3, 4)
FIRST_RECORDED = 4  # version that is stored with what it did
FAR = 40.0  # sizes of a plane that it is looked at from
Ids = Int64[np.ndarray, " m"]
Cells = Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class Fill:
    """Change that clones what is missing where rows stood at first from the planes that they stood on or before.

    A table goes on below a vase, a floor and a wall behind a shelf; what training left there unseen goes. Nothing is
    made up: no edge, no pattern with a place of its own; shadows and reflections stay, and what no plane holds is open.

    version: 2 clones nothing that lies on the plane or stands out from it, and by the shift with the best seam; 3 also
    lets other things in the hole be, such as what stands below a table; 4 fills as 3 does, and is stored with its
    record; 1 is what lists of edits without a version mean, and does none of it.

    record: what it does, None where that is still to be computed, from the scene and the objects at hand.

    Raises: InputError: another version, or a record of an earlier one.
    """

    version: int = VERSIONS[-1]
    record: FillRecord | None = None

    def __post_init__(self) -> None:
        if self.version not in VERSIONS:
            raise InputError(f"fill: expected version 1 to 4, got {self.version}: a newer drsplat may know it")
        if self.record is not None and self.version < FIRST_RECORDED:
            raise InputError(f"fill: version {self.version} has no record: leave it out, or give version 4")

    @property
    def lacks_record(self) -> bool:
        """True if this version is stored with a record, and there is none yet."""
        return self.record is None and self.version >= FIRST_RECORDED

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
        seen = ids[draft.opacities[ids] >= HAZE]
        if len(seen) < FEWEST:
            raise InputError(f"fill: {len(seen)} Gaussians that can be seen leave no hole: {FEWEST} are the fewest")
        thing = draft.homes[seen].astype(np.float64)
        near = _near(draft, ids, thing)
        scene = draft.part(near)
        places = scene.means.astype(np.float64)
        planes = planes_around(thing, places[scene.opacities >= HAZE])
        if not planes:
            raise InputError(
                "fill: no ground and no wall was found beside what was there: it stands free, or nothing flat of "
                "several sides is around it. The hole stays open"
            )
        removed, clones = np.zeros(len(near), bool), list[Clones]()
        for plane in planes:
            others = [other for other in planes if other is not plane]
            goes, more = _filled(near, scene, plane, others, thing, self.version)
            removed[goes] = True
            clones += more
        return FillRecord(spans_of(near[removed]), tuple(clones))


def _near(draft: Draft, ids: Ids, thing: Float64[np.ndarray, "t 3"]) -> Int64[np.ndarray, " k"]:
    """Rows that are there, around what stood there, without itself."""
    low, high = np.quantile(thing, (0.01, 0.99), axis=0)
    reach = AROUND * float(np.linalg.norm(high - low))
    near = ((draft.means >= low - reach) & (draft.means <= high + reach)).all(axis=1) & draft.present
    near[ids] = False
    return np.flatnonzero(near)


def _filled(
    near: Int64[np.ndarray, " k"], scene: Gaussians, plane: Plane, others: list[Plane],
    thing: Float64[np.ndarray, "t 3"], version: int,
) -> tuple[Ids, list[Clones]]:  # fmt: skip
    """Return which of the Gaussians near a thing go for a plane, and what is cloned. scene: those Gaussians."""
    places = scene.means.astype(np.float64)
    heights = plane.heights(places)
    surface = np.flatnonzero((np.abs(heights) <= plane.tolerance) & _is_flat(scene, plane) & _before(others, places))
    above = np.flatnonzero(heights > STANDS * plane.tolerance)
    flat = plane.flat(scene.means[surface].astype(np.float64))
    grid = _Grid.over(flat)
    bare = grid.coverage(scene.subset(above), plane) < CLEAR
    coverage = grid.coverage(scene.subset(surface), plane)
    foot = thing[plane.heights(thing) <= _foot(plane.heights(thing))]
    open_there = _before(others, grid.middles @ plane.axes + plane.offset * plane.normal).reshape(grid.shape)
    hole = grid.shadow(plane.flat(thing)) & (coverage < COVERED) | grid.shadow(plane.flat(foot))
    hole &= open_there
    cells = grid.cells(flat)
    missing, good, colors = hole.copy(), (coverage >= COVERED) & ~hole & bare, None
    own = np.ones(len(surface), bool)
    if version > 1:
        own = _own(scene, surface, grid, plane, cells)
        known = (grid.coverage(scene.subset(surface[own]), plane) >= COVERED) & ~hole
        colors = Surface(grid.colors(scene.subset(surface[own]), plane), known)
        good = known & ndimage.binary_erosion(bare, iterations=FOOT_CELLS, border_value=1)
    clones = []
    for _ in range(ROUNDS if hole.any() else 0):
        shift, closed = best_shift(missing, good, colors)
        if not closed.any():
            break
        source = np.zeros_like(good)
        down, across = np.nonzero(closed)
        source[down + shift[0], across + shift[1]] = True
        rows = surface[own & source[cells[:, 0], cells[:, 1]]]
        if len(rows):
            by = -grid.step * (np.array(shift, np.float64) @ plane.axes)
            clones.append(Clones(spans_of(near[rows]), by))
        missing &= ~closed
        colors = colors and colors.closed(closed, shift)
    if missing.sum() > (1 - ENOUGH) * hole.sum():
        share = 1 - missing.sum() / hole.sum()
        warnings.warn(f"fill: of one plane {share:.0%} of the hole could be closed", DrSplatWarning, stacklevel=2)
    return _guessed(scene, plane, grid, hole, version), clones


def _before(planes: list[Plane], places: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Places that are on the side of all of some planes that the object was on: the rest is below floors, in walls."""
    before = np.ones(len(places), bool)
    for plane in planes:
        before &= plane.heights(places) > plane.tolerance
    return before


def _foot(heights: Float64[np.ndarray, " t"]) -> float:
    """Height up to which an object stands on a plane."""
    low, high = np.quantile(heights, (0.02, 0.98))
    return float(low + FOOT * (high - low))


def _own(
    scene: Gaussians, surface: Ids, grid: "_Grid", plane: Plane, cells: Int64[np.ndarray, "m 2"]
) -> Bool[np.ndarray, " m"]:
    """Return which Gaussians in a plane are its own: of its objects, and of the colour that it has around them."""
    part = scene.subset(surface)
    drawn = Surface(grid.colors(part, plane), grid.coverage(part, plane) >= COVERED)
    own = drawn.holds(0.5 + SH_C0 * part.sh[:, 0].astype(np.float64), cells)
    owners = part.extra.get(OBJECT_ID)
    if owners is not None:
        _, which, counts = np.unique(owners, return_inverse=True, return_counts=True)
        own &= (counts >= LEAST_SHARE * len(surface))[which]
    return np.asarray(own)


def _guessed(scene: Gaussians, plane: Plane, grid: "_Grid", hole: Cells, version: int) -> Ids:
    """Return the Gaussians about a plane, in a hole of it, that training guessed there unseen."""
    low = np.flatnonzero(np.abs(plane.heights(scene.means.astype(np.float64))) <= STANDS * plane.tolerance)
    cells = grid.cells(plane.flat(scene.means[low].astype(np.float64)))
    goes = hole[cells[:, 0], cells[:, 1]]
    if version > 2:
        goes &= _is_of_surface(scene.subset(low), goes)
    return np.asarray(low[goes])


def _is_of_surface(low: Gaussians, in_hole: Bool[np.ndarray, " l"]) -> Bool[np.ndarray, " l"]:
    """Return which Gaussians about a plane are of no object, or of one that goes on beside the hole, like a floor."""
    owners = low.extra.get(OBJECT_ID)
    if owners is None:
        return np.ones(len(low), bool)
    _, which, counts = np.unique(owners, return_inverse=True, return_counts=True)
    return np.asarray((owners < 0) | (2 * np.bincount(which[in_hole], minlength=len(counts)) <= counts)[which])


def _is_flat(scene: Gaussians, plane: Plane) -> Bool[np.ndarray, " n"]:
    """Those that lie in the plane: needles that stick out of it would do so in the hole."""
    xx, xy, xz, yy, yz, zz = scene.covariances().T
    full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    flat = np.einsum("i,nij,j->n", plane.normal, full, plane.normal) <= plane.tolerance**2
    sizes = np.sort(scene.scales, axis=1)
    return np.asarray(flat & (sizes[:, 2] <= NEEDLE * sizes[:, 1]))


@dataclass(frozen=True, eq=False)
class _Grid:
    """Cells of a plane. low: the corner of the first. step: their side, in scene units."""

    low: Float64[np.ndarray, " 2"]
    step: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, points: Float64[np.ndarray, "n 2"]) -> "_Grid":
        low, size = points.min(axis=0), np.ptp(points, axis=0)
        step = float(size.max()) / CELLS
        rows, columns = (np.floor(size / step).astype(int) + 1).tolist()
        return cls(low, step, (rows, columns))

    def cells(self, points: Float64[np.ndarray, "n 2"]) -> Int64[np.ndarray, "n 2"]:
        return np.asarray(np.clip(((points - self.low) / self.step).astype(np.int64), 0, np.array(self.shape) - 1))

    @property
    def middles(self) -> Float64[np.ndarray, "c 2"]:
        rows, columns = np.indices(self.shape)
        return np.asarray(self.low + (np.stack([rows.ravel(), columns.ravel()], axis=1) + 0.5) * self.step)

    def shadow(self, points: Float64[np.ndarray, "n 2"]) -> Cells:
        """Cells below some points, and what they close in."""
        near = cKDTree(points).query(self.middles, distance_upper_bound=1.5 * self.step)[0] < np.inf
        closed: Cells = ndimage.binary_closing(near.reshape(self.shape), iterations=3) | near.reshape(self.shape)
        return np.asarray(ndimage.binary_fill_holes(closed))

    def coverage(self, gaussians: Gaussians, plane: Plane) -> Float64[np.ndarray, "h w"]:
        """Opacity of all Gaussians together in each cell, as a camera far away sees the plane."""
        return np.asarray(self._drawn(gaussians, plane).alpha, np.float64)

    def colors(self, gaussians: Gaussians, plane: Plane) -> Float64[np.ndarray, "h w 3"]:
        """Return the colour of each cell from where the object was, without the harmonics above the constant."""
        behind = plane.normal @ np.cross(plane.axes[1], plane.axes[0]) > 0  # as `_drawn` looks: then mirrored
        heights = plane.heights(gaussians.means.astype(np.float64)) if behind else np.zeros(len(gaussians))
        means = (gaussians.means - 2 * heights[:, None] * plane.normal).astype(np.float32)
        return np.asarray(self._drawn(replace(gaussians, means=means, sh=gaussians.sh[:, :1]), plane).rgb, np.float64)

    def _drawn(self, gaussians: Gaussians, plane: Plane) -> Picture:
        down, right = plane.axes
        ahead = np.cross(right, down)  # from either side: what is opaque is so from both
        middle = self.low + np.array(self.shape) / 2 * self.step
        eye = middle @ plane.axes + plane.offset * plane.normal - self.distance * ahead
        pose, focal = np.eye(4), self.distance / self.step
        pose[:3, :3] = np.stack([right, down, ahead])
        pose[:3, 3] = -pose[:3, :3] @ eye
        rows, columns = self.shape
        K = np.array([[focal, 0, columns / 2], [0, focal, rows / 2], [0, 0, 1.0]])
        here = replace(gaussians, origin=np.zeros(3))
        return render(here, View("plane", K, pose, columns, rows), threads=1)

    @property
    def distance(self) -> float:
        return FAR * self.step * max(self.shape)
