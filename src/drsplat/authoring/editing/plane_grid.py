"""Cells of a plane: what covers them and in which colour, seen square to the plane."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ...base.arrays import Bool, Float64, Int64
from ...drawing.rendering import Picture, render
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .planes import Plane

GRID_CELLS = 128  # along the longer side
VIEW_DISTANCE_SIZES = 40.0  # from which a plane is rendered, in its own sizes
Cells = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """Cells of a plane. low: the corner of the first. step: their side, in scene units."""

    plane: Plane
    low: Float64[np.ndarray, " 2"]
    step: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, plane: Plane, places: Float64[np.ndarray, "n 3"]) -> "PlaneGrid":
        """Return cells below all of some places."""
        points = plane.flat(places)
        low, size = points.min(axis=0), np.ptp(points, axis=0)
        step = float(size.max()) / GRID_CELLS
        rows, columns = (np.floor(size / step).astype(int) + 1).tolist()
        return cls(plane, low, step, (rows, columns))

    def cells(self, places: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, "n 2"]:
        """Return row and column of the cell below each place, of the nearest cell for places beside all."""
        steps = ((self.plane.flat(places) - self.low) / self.step).astype(np.int64)
        return np.asarray(np.clip(steps, 0, np.array(self.shape) - 1))

    def among(self, cells: Cells, places: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which places are over some cells."""
        down, across = self.cells(places).T
        return np.asarray(cells[down, across])

    @property
    def middles(self) -> Float64[np.ndarray, "c 3"]:
        """Middles of all cells, in the scene."""
        flat, plane = self._flat_middles, self.plane
        return np.asarray(flat @ plane.axes + plane.offset * plane.normal)

    @property
    def _flat_middles(self) -> Float64[np.ndarray, "c 2"]:
        rows, columns = np.indices(self.shape)
        return np.asarray(self.low + (np.stack([rows.ravel(), columns.ravel()], axis=1) + 0.5) * self.step)

    def shift(self, by: tuple[int, int]) -> Float64[np.ndarray, " 3"]:
        """Return by how far so many cells are, in the scene."""
        return np.asarray(self.step * (np.array(by, np.float64) @ self.plane.axes))

    def shadow(self, places: Float64[np.ndarray, "n 3"]) -> Cells:
        """Return the cells below some places, and what they close in."""
        distance = cKDTree(self.plane.flat(places)).query(self._flat_middles, distance_upper_bound=1.5 * self.step)[0]
        near = (distance < np.inf).reshape(self.shape)
        closed: Cells = ndimage.binary_closing(near, iterations=3) | near
        return np.asarray(ndimage.binary_fill_holes(closed))

    def coverage(self, gaussians: Gaussians) -> Float64[np.ndarray, "h w"]:
        """Return the opacity of all Gaussians together in each cell, as a camera far away sees the plane."""
        return np.asarray(self._drawn(gaussians).alpha, np.float64)

    def colors(self, gaussians: Gaussians) -> Float64[np.ndarray, "h w 3"]:
        """Return the colour of each cell from where the object was, without the harmonics above the constant."""
        plane = self.plane
        behind = plane.normal @ np.cross(plane.axes[1], plane.axes[0]) > 0  # as `_drawn` looks: then mirrored
        heights = plane.heights(gaussians.means.astype(np.float64)) if behind else np.zeros(len(gaussians))
        means = (gaussians.means - 2 * heights[:, None] * plane.normal).astype(np.float32)
        return np.asarray(self._drawn(replace(gaussians, means=means, sh=gaussians.sh[:, :1])).rgb, np.float64)

    def _drawn(self, gaussians: Gaussians) -> Picture:
        down, right = self.plane.axes
        ahead = np.cross(right, down)  # from either side: what is opaque is so from both
        middle, distance = (
            self.low + np.array(self.shape) / 2 * self.step,
            VIEW_DISTANCE_SIZES * self.step * max(self.shape),
        )
        eye = middle @ self.plane.axes + self.plane.offset * self.plane.normal - distance * ahead
        pose, focal = np.eye(4), distance / self.step
        pose[:3, :3] = np.stack([right, down, ahead])
        pose[:3, 3] = -pose[:3, :3] @ eye
        rows, columns = self.shape
        K = np.array([[focal, 0, columns / 2], [0, focal, rows / 2], [0, 0, 1.0]])
        here = replace(gaussians, origin=np.zeros(3))
        return render(here, View("plane", K, pose, columns, rows), threads=1)
