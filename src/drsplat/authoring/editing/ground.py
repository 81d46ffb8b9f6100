"""The ground or wall of a thing: the Gaussians of one plane near it, whose they are, and the hole in them."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve
from scipy.spatial import ConvexHull, QhullError, cKDTree

from ...base.arrays import (
    Array,
    Doubles,
    Flags,
    Float64,
    Int64,
    Mask,
    OtherPoints,
    PlanePoints,
    Points,
    RowIds,
    Spans,
    Vector3,
    WholeNumbers,
)
from ...drawing.rendering import Picture, render
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import SH_C0, Gaussians
from ...scene.views import View
from .draft import OBJECT_ID
from .planes import Plane

COVERED_OPACITY = 0.6  # of a plane, from which on it hides what is behind it
HINT_OPACITY = 0.05  # of a plane, from which on there is some of it in a cell
FOOT_HEIGHT_SHARE = 0.15  # lowest part of an object: no photo saw the ground below it, and training guessed
MIN_STANDING_TOLERANCES = 1.3  # above a plane, from which on something stands on it
MAX_BARE_OPACITY = 0.2  # of what stands on a plane where the plane counts as bare
MAX_ELONGATION = 6.0  # length over width: what is longer is no patch of a surface
MIN_OWNER_SHARE = 0.2  # of the Gaussians in a plane, for an object that the plane is part of
MIN_IN_PLANE_SHARE = 1 / 3  # of such an object's Gaussians: it consists of this plane and of others like it
RING_CELLS = 12  # around a hole: objects in the ring may continue into the hole
MIN_SURROUNDED_SHARE = 0.5  # of a hole, by the rest of the plane: less, and the hole lies beside the plane
Places = Points
GRID_CELLS = 128  # along the longer side
VIEW_DISTANCE_SIZES = 40.0  # from which a plane is rendered, in its own sizes
Cells = Mask
MEDIAN_WINDOW_CELLS = 21  # side of the window whose median colour a plane has in its middle
MIN_OUTLIER_DIFFERENCE = 0.12  # from that colour, of 1
OUTLIER_MEDIANS = 1.5  # in median differences: an outlier exceeds both
MIN_CLOSED_OF_BEST_SHARE = 0.9  # of the cells that the best shift closes: among such shifts the seam decides
MAX_SEAM_SHIFTS = 100  # whose seams are compared
SEAM_CELLS = 2  # around the missing ones
Colors = Float64[np.ndarray, "h w 3"]
Shifts = Int64[np.ndarray, "s 2"]


@dataclass(frozen=True, eq=False)
class Surface:
    """The cells of a plane: their colours, and whether each is known, which it is outside of holes."""

    colors: Colors
    known: Cells

    def holds(self, colors: Points, cells: Shifts) -> Flags:
        """Return which Gaussians, in some cells, are of the surface: not cutlery, crumbs, whatever lies on it.

        Neither they nor what is drawn in their cells stand out from the colour around.
        """
        if not self.known.any():
            return np.ones(len(colors), bool)
        drawn = np.where(self.known[..., None], self.colors, np.median(self.colors[self.known], axis=0))
        middle = ndimage.median_filter(drawn, (MEDIAN_WINDOW_CELLS, MEDIAN_WINDOW_CELLS, 1))
        off = np.abs(drawn - middle).max(2)
        plain = ~ndimage.binary_dilation(self.known & (off > _limit(off[self.known])))[cells[:, 0], cells[:, 1]]
        off = np.abs(colors - middle[cells[:, 0], cells[:, 1]]).max(1)
        return plain & (off <= _limit(off))

    def seam(self, missing: Cells, shift: Int64[Array, " 2"]) -> float:
        """Return how far the colours that a shift brings are from those around a hole; infinite where few are known."""
        ring = np.argwhere(ndimage.binary_dilation(missing, iterations=SEAM_CELLS) & ~missing & self.known)
        ring, there = _within(ring, shift, missing.shape)
        good = self.known[there[:, 0], there[:, 1]]
        if 2 * np.count_nonzero(good) < max(1, len(ring)):
            return np.inf
        ring, there = ring[good], there[good]
        return float(np.abs(self.colors[ring[:, 0], ring[:, 1]] - self.colors[there[:, 0], there[:, 1]]).mean())

    def closed(self, cells: Cells, shift: tuple[int, int]) -> "Surface":
        """Return the surface with colours cloned into some cells."""
        at, colors = np.argwhere(cells), self.colors.copy()
        there = at + shift
        colors[at[:, 0], at[:, 1]] = self.colors[there[:, 0], there[:, 1]]
        return Surface(colors, self.known | cells)


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """Cells of a plane. low: the corner of the first. step: their side, in scene units."""

    plane: Plane
    low: Float64[Array, " 2"]
    step: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, plane: Plane, places: Points) -> "PlaneGrid":
        """Return cells below all of some places."""
        points = plane.flat(places)
        low, size = points.min(0), np.ptp(points, axis=0)
        step = float(size.max()) / GRID_CELLS
        rows, columns = (np.floor(size / step).astype(int) + 1).tolist()
        return cls(plane, low, step, (rows, columns))

    def cells(self, places: Points) -> Spans:
        """Return row and column of the cell below each place, of the nearest cell for places beside all."""
        steps = ((self.plane.flat(places) - self.low) / self.step).astype(np.int64)
        return np.clip(steps, 0, np.array(self.shape) - 1)

    def among(self, cells: Cells, places: Points) -> Flags:
        """Return which places are over some cells."""
        down, across = self.cells(places).T
        return cells[down, across]

    @property
    def middles(self) -> Points:
        """Middles of all cells, in the scene."""
        return self._flat_middles @ self.plane.axes + self.plane.offset * self.plane.normal

    @property
    def _flat_middles(self) -> PlanePoints:
        rows, columns = np.indices(self.shape)
        return self.low + (np.stack([rows.ravel(), columns.ravel()], axis=1) + 0.5) * self.step

    def shift(self, by: tuple[int, int]) -> Vector3:
        """Return by how far so many cells are, in the scene."""
        return self.step * (np.array(by, np.float64) @ self.plane.axes)

    def shadow(self, places: Points) -> Cells:
        """Return the cells below some places, and what they close in."""
        distance = cKDTree(self.plane.flat(places)).query(self._flat_middles, distance_upper_bound=1.5 * self.step)[0]
        near = (distance < np.inf).reshape(self.shape)
        closed: Cells = ndimage.binary_closing(near, iterations=3) | near
        return ndimage.binary_fill_holes(closed)

    def coverage(self, gaussians: Gaussians) -> Float64[Array, "h w"]:
        """Return the opacity of all Gaussians together in each cell, as a camera far away sees the plane."""
        return np.asarray(self._drawn(gaussians).alpha, np.float64)

    def colors(self, gaussians: Gaussians) -> Float64[Array, "h w 3"]:
        """Return the colour of each cell from where the object was, without the harmonics above the constant."""
        plane = self.plane
        behind = plane.normal @ np.cross(plane.axes[1], plane.axes[0]) > 0  # as `_drawn` looks: then mirrored
        heights = plane.heights(gaussians.means.astype(np.float64)) if behind else np.zeros(len(gaussians))
        means = (gaussians.means - 2 * heights[:, None] * plane.normal).astype(np.float32)
        return np.asarray(self._drawn(replace(gaussians, means=means, sh=gaussians.sh[:, :1])).rgb, np.float64)

    def _drawn(self, gaussians: Gaussians) -> Picture:
        down, right = self.plane.axes
        ahead = np.cross(right, down)  # from either side: what is opaque is so from both
        middle = self.low + np.array(self.shape) / 2 * self.step
        distance = VIEW_DISTANCE_SIZES * self.step * max(self.shape)
        eye = middle @ self.plane.axes + self.plane.offset * self.plane.normal - distance * ahead
        axes, size = np.stack([right, down, ahead]), self.shape[::-1]
        here = replace(gaussians, origin=np.zeros(3))
        return render(here, View.standing("plane", eye, axes, distance / self.step, size), threads=1)


@dataclass(frozen=True, eq=False)
class Ground:
    """A plane and the Gaussians near a thing. thing: where it was. rows: of those that lie in the plane like patches.

    behind: planes that nothing of this one lies behind.
    """

    scene: Gaussians
    plane: Plane
    behind: list[Plane]
    thing: Places

    @cached_property
    def places(self) -> Places:
        return self.scene.means.astype(np.float64)

    @cached_property
    def heights(self) -> Doubles:
        return self.plane.heights(self.places)

    @cached_property
    def rows(self) -> RowIds:
        lies = (np.abs(self.heights) <= self.plane.tolerance) & is_flat(self.scene, self.plane)
        return np.flatnonzero(lies & before(self.behind, self.places))

    @cached_property
    def grid(self) -> PlaneGrid:
        return PlaneGrid.over(self.plane, self.places[self.rows])

    @cached_property
    def owners(self) -> WholeNumbers | None:
        """Objects of the Gaussians, -1 for none."""
        return self.scene.extra.get(OBJECT_ID)

    @property
    def bare(self) -> Cells:
        """Cells that nothing stands on."""
        above = np.flatnonzero(self.heights > MIN_STANDING_TOLERANCES * self.plane.tolerance)
        return self.grid.coverage(self.scene.subset(above)) < MAX_BARE_OPACITY

    @cached_property
    def shadow(self) -> Cells:
        """Cells below the thing."""
        return self.grid.shadow(self.thing)

    @cached_property
    def hole(self) -> Cells:
        """Cells below the thing that nothing covers but what is nobody's, and those below its foot.

        Masks give objects what photos see: what is nobody's is what training guessed, unless it is much of the plane.
        """
        some, owners, grid = self.rows, self.owners, self.grid
        if owners is not None and np.mean(owners[some] < 0) < MIN_OWNER_SHARE:
            some = some[owners[some] >= 0]
        heights = self.plane.heights(self.thing)
        low, high = np.quantile(heights, (0.02, 0.98))
        foot = grid.shadow(self.thing[heights <= float(low + FOOT_HEIGHT_SHARE * (high - low))])
        in_front = before(self.behind, grid.middles).reshape(grid.shape)
        return (self.shadow & (grid.coverage(self.scene.subset(some)) < COVERED_OPACITY) | foot) & in_front

    @cached_property
    def main_owners(self) -> WholeNumbers:
        """Objects, -1 for none, that have much of the plane, or of what of it is around the hole."""
        around = ndimage.binary_dilation(self.hole, iterations=RING_CELLS) & ~self.hole
        beside = self.rows[self.grid.among(around, self.places[self.rows])]
        if self.owners is None:
            return np.zeros(0, np.int64)
        found = []
        for rows in (self.rows, beside):
            owners, counts = np.unique(self.owners[rows], return_counts=True)
            found.append(owners[counts >= MIN_OWNER_SHARE * len(rows)])
        return np.unique(np.concatenate(found))

    @cached_property
    def own(self) -> RowIds:
        """Gaussians in the plane that are its own: of its objects, and of the colour that it has around them."""
        part, cells = self.scene.subset(self.rows), self.grid.cells(self.places[self.rows])
        drawn = Surface(self.grid.colors(part), self.grid.coverage(part) >= COVERED_OPACITY)
        own = drawn.holds(0.5 + SH_C0 * part.sh[:, 0].astype(np.float64), cells)
        if self.owners is not None:
            own &= np.isin(self.owners[self.rows], self.main_owners)
        return self.rows[own]

    @cached_property
    def own_coverage(self) -> Float64[Array, "h w"]:
        return self.grid.coverage(self.scene.subset(self.own))

    @property
    def surface(self) -> Surface:
        """The plane's own colours, known outside of the hole."""
        known = (self.own_coverage >= COVERED_OPACITY) & ~self.hole
        return Surface(self.grid.colors(self.scene.subset(self.own)), known)

    @cached_property
    def is_around_hole(self) -> bool:
        """True if there is a hole, and at least half of it lies within the convex hull of the plane's own."""
        cells = np.argwhere(self.hole)
        try:
            sides = ConvexHull(np.argwhere(self.own_coverage >= HINT_OPACITY)).equations
        except (QhullError, ValueError):  # fewer than three cells, or all in a row
            return False
        within = (np.einsum("ci,si->cs", cells, sides[:, :2]) + sides[:, 2] <= 0).all(1)
        return bool(len(cells) and within.mean() >= MIN_SURROUNDED_SHARE)

    @property
    def guessed(self) -> RowIds:
        """Gaussians about the plane, in the hole of it, that training guessed there unseen."""
        low = np.flatnonzero(np.abs(self.heights) <= MIN_STANDING_TOLERANCES * self.plane.tolerance)
        goes = self.grid.among(self.hole, self.places[low])
        if self.owners is not None:
            owners = self.owners[low]
            _, which, counts = np.unique(owners, return_inverse=True, return_counts=True)
            goes &= (owners < 0) | (2 * np.bincount(which[goes], minlength=len(counts)) <= counts)[which]
        return low[goes]

    @cached_property
    def standing(self) -> RowIds:
        """Gaussians of the plane's objects that stand off it in the thing's place, nearer to it than to other things.

        Such an object is one surface, with nothing above it: they were inside of the thing or part of it.
        """
        if self.owners is None:
            return np.zeros(0, np.int64)
        lies = np.abs(self.heights) <= self.plane.tolerance
        flat = [one for one in self.main_owners if one >= 0 and lies[self.owners == one].mean() >= MIN_IN_PLANE_SHARE]
        top = np.quantile(self.plane.heights(self.thing), 0.98)
        some = (
            np.isin(self.owners, flat)
            & (self.heights > MIN_STANDING_TOLERANCES * self.plane.tolerance)
            & (self.heights <= top)
        )
        rows = np.flatnonzero(some)
        rows = rows[self.grid.among(self.shadow, self.places[rows])]
        others = self.places[(self.owners >= 0) & ~np.isin(self.owners, flat) & (self.scene.opacities >= HAZE_OPACITY)]
        places = self.places[rows]
        return rows[_distances(places, self.thing) < _distances(places, others)]


def before(planes: list[Plane], places: Places) -> Flags:
    """Return which places are on the side of all planes that the object was on: the rest is below floors, in walls."""
    result = np.ones(len(places), bool)
    for plane in planes:
        result &= plane.heights(places) > plane.tolerance
    return result


def is_flat(scene: Gaussians, plane: Plane) -> Flags:
    """Return which Gaussians lie in the plane: needles that stick out of it would do so in the hole."""
    xx, xy, xz, yy, yz, zz = scene.covariances().T
    full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    flat = np.einsum("i,nij,j->n", plane.normal, full, plane.normal) <= plane.tolerance**2
    sizes = np.sort(scene.scales, axis=1)
    return flat & (sizes[:, 2] <= MAX_ELONGATION * sizes[:, 1])


def _distances(places: Places, points: OtherPoints) -> Doubles:
    """Return how far each place is from the nearest point; infinite without any."""
    return np.asarray(cKDTree(points).query(places)[0]) if len(points) else np.full(len(places), np.inf)


def _limit(off: Doubles) -> float:
    return max(MIN_OUTLIER_DIFFERENCE, OUTLIER_MEDIANS * float(np.median(off)))


def best_shift(missing: Cells, good: Cells, surface: Surface) -> tuple[tuple[int, int], Cells]:
    """Return by how many cells a good one is away from most of what is missing, and the cells that this closes.

    Of shifts that close nearly as much, the one with the best seam.
    """
    counts = np.round(fftconvolve(good.astype(float), missing[::-1, ::-1].astype(float))).astype(int)
    rows, columns = (np.arange(length) - (side - 1) for length, side in zip(counts.shape, missing.shape, strict=True))
    lengths = np.hypot(rows[:, None], columns[None])
    order = np.lexsort((lengths.ravel(), -counts.ravel()))
    nearly = order[: np.count_nonzero(counts >= max(1.0, MIN_CLOSED_OF_BEST_SHARE * counts.max()))]
    order = nearly[:: -(-len(nearly) // MAX_SEAM_SHIFTS)] if len(nearly) else order[:1]  # closes nothing
    down, across = np.unravel_index(order, counts.shape)
    shifts = np.stack([rows[down], columns[across]], axis=1)
    best = int(np.argmin([surface.seam(missing, shift) for shift in shifts]))
    at, there = _within(np.argwhere(missing), shifts[best], missing.shape)
    closed = np.zeros_like(missing)
    closed[at[:, 0], at[:, 1]] = good[there[:, 0], there[:, 1]]
    return (int(shifts[best][0]), int(shifts[best][1])), closed


def _within(cells: Shifts, shift: Int64[Array, " 2"] | tuple[int, int], shape: tuple[int, ...]) -> tuple[Spans, Spans]:
    """Return the cells whose shifted ones are on the grid, and these."""
    there = cells + shift
    inside = ((there >= 0) & (there < np.array(shape))).all(1)
    return cells[inside], there[inside]
