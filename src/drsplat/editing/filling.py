"""The hole that a removal leaves: ground and wall Gaussians cloned from beside it, along their plane."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve
from scipy.spatial import cKDTree

from ..arrays import Bool, Float64, Int64
from ..drawing.rendering import render
from ..errors import DrSplatWarning, InputError
from ..scene.boxes import HAZE
from ..scene.gaussians import Gaussians
from ..scene.views import View
from .draft import Draft
from .planes import Plane, planes_around

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
FAR = 40.0  # sizes of a plane that it is looked at from
Ids = Int64[np.ndarray, " m"]
Cells = Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class Fill:
    """What is missing where these rows stood at first is cloned from the planes that they stood on or before.

    A table goes on below a vase, a floor and a wall behind a shelf; what training left there unseen goes. Nothing is
    made up: no edge, no pattern with a place of its own; shadows and reflections stay, and what no plane holds is open.
    """

    def apply(self, draft: Draft, ids: Ids) -> None:
        """Raises: InputError: too few rows to leave a hole, or no plane was found. Warns: DrSplatWarning: a hole that
        could be closed in part only.
        """
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
        for plane in planes:
            _fill(draft, near, scene, plane, [other for other in planes if other is not plane], thing)


def _near(draft: Draft, ids: Ids, thing: Float64[np.ndarray, "t 3"]) -> Int64[np.ndarray, " k"]:
    """Rows that are there, around what stood there, without itself."""
    low, high = np.quantile(thing, (0.01, 0.99), axis=0)
    reach = AROUND * float(np.linalg.norm(high - low))
    near = ((draft.means >= low - reach) & (draft.means <= high + reach)).all(axis=1) & draft.present
    near[ids] = False
    return np.flatnonzero(near)


def _fill(
    draft: Draft, near: Ids, scene: Gaussians, plane: Plane, others: list[Plane], thing: Float64[np.ndarray, "t 3"]
) -> None:  # fmt: skip
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
    low = np.flatnonzero(np.abs(heights) <= STANDS * plane.tolerance)
    below = grid.cells(plane.flat(scene.means[low].astype(np.float64)))
    draft.present[near[low[hole[below[:, 0], below[:, 1]]]]] = False
    missing, good = hole.copy(), (coverage >= COVERED) & ~hole & bare
    for _ in range(ROUNDS if hole.any() else 0):
        shift, closed = _best_shift(missing, good)
        if not closed.any():
            break
        source = np.zeros_like(good)
        rows, columns = np.nonzero(closed)
        source[rows + shift[0], columns + shift[1]] = True
        clones = draft.add(draft.part(near[surface[source[cells[:, 0], cells[:, 1]]]]))
        draft.shift(clones, -grid.step * (np.array(shift, np.float64) @ plane.axes))
        draft.homes[clones] = draft.means[clones]
        missing &= ~closed
    if missing.sum() > (1 - ENOUGH) * hole.sum():
        share = 1 - missing.sum() / hole.sum()
        warnings.warn(f"fill: of one plane {share:.0%} of the hole could be closed", DrSplatWarning, stacklevel=2)


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


def _is_flat(scene: Gaussians, plane: Plane) -> Bool[np.ndarray, " n"]:
    """Those that lie in the plane: needles that stick out of it would do so in the hole."""
    xx, xy, xz, yy, yz, zz = scene.covariances().T
    full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    flat = np.einsum("i,nij,j->n", plane.normal, full, plane.normal) <= plane.tolerance**2
    sizes = np.sort(scene.scales, axis=1)
    return np.asarray(flat & (sizes[:, 2] <= NEEDLE * sizes[:, 1]))


def _best_shift(missing: Cells, good: Cells) -> tuple[tuple[int, int], Cells]:
    """By how many cells a good one is away from most of what is missing, the nearest of equals; and those cells."""
    counts = np.round(fftconvolve(good.astype(float), missing[::-1, ::-1].astype(float))).astype(int)
    rows, columns = (np.arange(length) - (side - 1) for length, side in zip(counts.shape, missing.shape, strict=True))
    lengths = np.hypot(rows[:, None], columns[None])
    best = np.lexsort((lengths.ravel(), -counts.ravel()))[0]
    down, across = np.unravel_index(best, counts.shape)
    shift = (int(rows[down]), int(columns[across]))
    at = np.argwhere(missing)
    there = at + shift
    inside = ((there >= 0) & (there < missing.shape)).all(axis=1)
    closed = np.zeros_like(missing)
    at, there = at[inside], there[inside]
    closed[at[:, 0], at[:, 1]] = good[there[:, 0], there[:, 1]]
    return shift, closed


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
        return np.asarray(render(here, View("plane", K, pose, columns, rows), threads=1).alpha, np.float64)

    @property
    def distance(self) -> float:
        return FAR * self.step * max(self.shape)
