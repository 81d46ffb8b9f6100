"""The ground or wall of a thing: the Gaussians of one plane near it, whose they are, and the hole in them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError, cKDTree

from ...base.arrays import Bool, Float64, Int64, Integer
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import SH_C0, Gaussians
from .draft import OBJECT_ID
from .plane_grid import Cells, PlaneGrid
from .planes import Plane
from .shifts import Surface

COVERED_OPACITY = 0.6  # of a plane, from which on it hides what is behind it
HINT_OPACITY = 0.05  # of a plane, from which on there is some of it in a cell
FOOT_HEIGHT_SHARE = 0.15  # lowest part of an object: no photo saw the ground below it, and training guessed
MIN_STANDING_TOLERANCES = 1.3  # above a plane, from which on something stands on it
MAX_BARE_OPACITY = 0.2  # of what stands on a plane where the plane counts as bare
MAX_ELONGATION = 6.0  # length over width: what is longer is no patch of a surface
FOOT_CELLS = 3  # around what stands on a plane: its foot may reach so far into the plane
MIN_OWNER_SHARE = 0.2  # of the Gaussians in a plane, for an object that the plane is part of
MIN_IN_PLANE_SHARE = 1 / 3  # of such an object's Gaussians: it consists of this plane and of others like it
RING_CELLS = 12  # around a hole: objects in the ring may continue into the hole
MIN_SURROUNDED_SHARE = 0.5  # of a hole, by the rest of the plane: less, and the hole lies beside the plane
Ids = Int64[np.ndarray, " m"]
Places = Float64[np.ndarray, "n 3"]


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
    def heights(self) -> Float64[np.ndarray, " n"]:
        return self.plane.heights(self.places)

    @cached_property
    def rows(self) -> Ids:
        lies = (np.abs(self.heights) <= self.plane.tolerance) & is_flat(self.scene, self.plane)
        return np.flatnonzero(lies & before(self.behind, self.places))

    @cached_property
    def grid(self) -> PlaneGrid:
        return PlaneGrid.over(self.plane, self.places[self.rows])

    @cached_property
    def owners(self) -> Integer[np.ndarray, " n"] | None:
        """Objects of the Gaussians, -1 for none."""
        return self.scene.extra.get(OBJECT_ID)

    @cached_property
    def bare(self) -> Cells:
        """Cells that nothing stands on."""
        above = np.flatnonzero(self.heights > MIN_STANDING_TOLERANCES * self.plane.tolerance)
        return np.asarray(self.grid.coverage(self.scene.subset(above)) < MAX_BARE_OPACITY)

    @cached_property
    def in_front(self) -> Cells:
        """Cells before all planes behind."""
        return before(self.behind, self.grid.middles).reshape(self.grid.shape)

    @cached_property
    def shadow(self) -> Cells:
        """Cells below the thing."""
        return self.grid.shadow(self.thing)

    @cached_property
    def foot(self) -> Cells:
        """Cells below what of the thing is lowest."""
        heights = self.plane.heights(self.thing)
        low, high = np.quantile(heights, (0.02, 0.98))
        return self.grid.shadow(self.thing[heights <= float(low + FOOT_HEIGHT_SHARE * (high - low))])

    @cached_property
    def hole(self) -> Cells:
        """Cells below the thing that nothing covers but what is nobody's, and those below its foot.

        Masks give objects what photos see: what is nobody's is what training guessed, unless it is much of the plane.
        """
        some, owners = self.rows, self.owners
        if owners is not None and np.mean(owners[some] < 0) < MIN_OWNER_SHARE:
            some = some[owners[some] >= 0]
        return self.hole_in(self.grid.coverage(self.scene.subset(some)))

    def hole_in(self, coverage: Float64[np.ndarray, "h w"]) -> Cells:
        """Return the cells below the thing that are not covered, and those below its foot."""
        return np.asarray((self.shadow & (coverage < COVERED_OPACITY) | self.foot) & self.in_front)

    @cached_property
    def main_owners(self) -> Integer[np.ndarray, " o"]:
        """Objects, -1 for none, that have much of the plane, or of what of it is around the hole."""
        around = ndimage.binary_dilation(self.hole, iterations=RING_CELLS) & ~self.hole
        beside = self.rows[self.grid.among(around, self.places[self.rows])]
        return np.union1d(self.owners_of(self.rows), self.owners_of(beside))

    def owners_of(self, rows: Ids) -> Integer[np.ndarray, " o"]:
        """Return the objects, -1 for none, that have much of some rows."""
        if self.owners is None:
            return np.zeros(0, np.int64)
        owners, counts = np.unique(self.owners[rows], return_counts=True)
        return np.asarray(owners[counts >= MIN_OWNER_SHARE * len(rows)])

    @cached_property
    def own(self) -> Ids:
        """Gaussians in the plane that are its own: of its objects, and of the colour that it has around them."""
        part, cells = self.scene.subset(self.rows), self.grid.cells(self.places[self.rows])
        drawn = Surface(self.grid.colors(part), self.grid.coverage(part) >= COVERED_OPACITY)
        own = drawn.holds(0.5 + SH_C0 * part.sh[:, 0].astype(np.float64), cells)
        if self.owners is not None:
            own &= np.isin(self.owners[self.rows], self.main_owners)
        return np.asarray(self.rows[own])

    @cached_property
    def own_coverage(self) -> Float64[np.ndarray, "h w"]:
        return self.grid.coverage(self.scene.subset(self.own))

    def surface(self, hole: Cells) -> Surface:
        """Return the plane's own colours, known outside of a hole."""
        return Surface(self.grid.colors(self.scene.subset(self.own)), (self.own_coverage >= COVERED_OPACITY) & ~hole)

    def cloneable(self, known: Cells) -> Cells:
        """Return known cells that nothing stands on or beside."""
        return np.asarray(known & ndimage.binary_erosion(self.bare, iterations=FOOT_CELLS, border_value=1))

    @cached_property
    def is_around_hole(self) -> bool:
        """True if there is a hole, and at least half of it lies within the convex hull of the plane's own."""
        cells = np.argwhere(self.hole)
        try:
            sides = ConvexHull(np.argwhere(self.own_coverage >= HINT_OPACITY)).equations
        except (QhullError, ValueError):  # fewer than three cells, or all in a row
            return False
        within = (np.einsum("ci,si->cs", cells, sides[:, :2]) + sides[:, 2] <= 0).all(axis=1)
        return bool(len(cells) and within.mean() >= MIN_SURROUNDED_SHARE)

    def guessed(self, hole: Cells) -> Ids:
        """Return the Gaussians about the plane, in a hole of it, that training guessed there unseen."""
        low = np.flatnonzero(np.abs(self.heights) <= MIN_STANDING_TOLERANCES * self.plane.tolerance)
        goes = self.grid.among(hole, self.places[low])
        if self.owners is not None:
            goes &= _is_of_surface(self.owners[low], goes)
        return np.asarray(low[goes])

    @cached_property
    def standing(self) -> Ids:
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
        return np.asarray(rows[_distances(places, self.thing) < _distances(places, others)])


def before(planes: list[Plane], places: Places) -> Bool[np.ndarray, " n"]:
    """Return which places are on the side of all planes that the object was on: the rest is below floors, in walls."""
    result = np.ones(len(places), bool)
    for plane in planes:
        result &= plane.heights(places) > plane.tolerance
    return result


def is_flat(scene: Gaussians, plane: Plane) -> Bool[np.ndarray, " n"]:
    """Return which Gaussians lie in the plane: needles that stick out of it would do so in the hole."""
    xx, xy, xz, yy, yz, zz = scene.covariances().T
    full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    flat = np.einsum("i,nij,j->n", plane.normal, full, plane.normal) <= plane.tolerance**2
    sizes = np.sort(scene.scales, axis=1)
    return np.asarray(flat & (sizes[:, 2] <= MAX_ELONGATION * sizes[:, 1]))


def _is_of_surface(owners: Integer[np.ndarray, " l"], in_hole: Bool[np.ndarray, " l"]) -> Bool[np.ndarray, " l"]:
    """Return which Gaussians about a plane are of no object, or of one that goes on beside the hole, like a floor."""
    _, which, counts = np.unique(owners, return_inverse=True, return_counts=True)
    return np.asarray((owners < 0) | (2 * np.bincount(which[in_hole], minlength=len(counts)) <= counts)[which])


def _distances(places: Places, points: Float64[np.ndarray, "p 3"]) -> Float64[np.ndarray, " n"]:
    """Return how far each place is from the nearest point; infinite without any."""
    return np.asarray(cKDTree(points).query(places)[0]) if len(points) else np.full(len(places), np.inf)
