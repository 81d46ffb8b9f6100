"""Free space of a scene in which a camera can stand, and the surroundings of each place."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ...base.arrays import Flags, Numbers, OtherPoints, Points, Vector3
from ...kernels import SplatArrays, render_channels, splat_arrays
from ...scene.gaussians import MIN_SIZED_GAUSSIANS, SOLID_OPACITY, Gaussians
from ..filming.looking import looking_at

VOXELS_PER_SIDE = 48  # along the longest side of the scene's box
BOX_QUANTILES = (0.02, 0.98)  # of the centres of solid Gaussians, along each axis
OCCUPIED_OPACITY = 0.5  # summed over a voxel
CLEARANCE_SHARE = 0.03  # of the box's diagonal, at least, from a camera to the nearest surface
CLEARANCE_NEARS = 2.0  # near planes, at least
INSIDE_SIGMAS = 3.0  # a place within so many standard deviations of a Gaussian is inside it
MAX_NEAR_SHARE = 0.05  # of a picture, for Gaussians right before the camera
FACE_PIXELS = 24  # side of the six square pictures that look all around
SURE_ALPHA = 0.5  # opacity of a pixel that shows something
PROBE_NEAR_SHARE = 0.05  # of the clearance, so that probes show what a camera's near plane would cut off


class Surroundings(NamedTuple):
    """Surroundings of a camera.

    enclosed: share of all directions in which there is something. near_share: share of the view that belongs to
    Gaussians right before the camera, or around it.
    """

    enclosed: float
    near_share: float

    @property
    def is_free(self) -> bool:
        """True where a camera can stand."""
        return self.near_share <= MAX_NEAR_SHARE


@dataclass(frozen=True, eq=False)
class Space:
    """Still scene, as a space for cameras.

    Attributes:
        gaussians: the scene.
        up: unit direction that is up.
        threads: of the kernels; the result does not depend on it.
    """

    gaussians: Gaussians
    up: Vector3
    threads: int = 0

    @cached_property
    def splats(self) -> SplatArrays:
        return splat_arrays(self.gaussians)

    @cached_property
    def solid(self) -> Points:
        """Centres of the solid Gaussians, in world coordinates; all centres where too few are solid."""
        return solid_centers(self.gaussians)

    @cached_property
    def box(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box of most solid Gaussians."""
        low, high = np.quantile(self.solid, BOX_QUANTILES, axis=0)
        return low, high

    @cached_property
    def reaches(self) -> Numbers:
        """Distance from each centre up to which a place may be inside of the Gaussian, in scene units."""
        return np.float32(INSIDE_SIGMAS) * self.gaussians.scales.max(1)

    @cached_property
    def positions(self) -> Points:
        """Centres of all Gaussians in world coordinates."""
        return self.gaussians.positions

    @property
    def diagonal(self) -> float:
        """Diagonal of the box, in scene units."""
        return max(float(np.linalg.norm(self.box[1] - self.box[0])), 1e-6)

    @property
    def clearance(self) -> float:
        """Least distance from a camera to a surface, in scene units."""
        return max(CLEARANCE_SHARE * self.diagonal, CLEARANCE_NEARS * self.splats.near)

    @cached_property
    def bottom(self) -> float:
        """Height along `up` that nearly all solid Gaussians lie above."""
        return float(np.quantile(self.solid @ self.up, BOX_QUANTILES[0]))

    @cached_property
    def free_places(self) -> Points:
        """Centres of the voxels of the box that are further than the clearance from occupied ones, far ones first."""
        low, high = self.box
        side = max(float((high - low).max()), 1e-6) / VOXELS_PER_SIDE
        shape = np.maximum(np.ceil((high - low) / side).astype(int), 1)
        inside = np.floor((self._surface_points - low) / side).astype(int)
        in_box = ((inside >= 0) & (inside < shape)).all(1)
        flat = np.ravel_multi_index(tuple(inside[in_box].T), tuple(shape))
        opacity = np.bincount(flat, np.tile(self.gaussians.opacities, 7)[in_box], minlength=int(shape.prod()))
        occupied = (opacity >= OCCUPIED_OPACITY).reshape(shape)
        if not occupied.any():
            return np.empty((0, 3))
        away = ndimage.distance_transform_edt(~occupied, sampling=side)
        free = np.argwhere(away >= max(self.clearance, side))
        order = np.argsort(-away[tuple(free.T)], kind="stable")
        return low + (free[order] + 0.5) * side

    @cached_property
    def _surface_points(self) -> Points:
        """Centres of all Gaussians, and one standard deviation to both sides along each of their axes."""
        from ...scene.gaussians import rotation_matrices

        g = self.gaussians
        arms = rotation_matrices(g.quats.astype(np.float64)) * g.scales[:, None, :]
        steps = [arms[:, :, axis] * sign for axis in range(3) for sign in (1, -1)]
        return np.concatenate([g.positions, *(g.positions + step for step in steps)])

    def is_near(self, eye: Vector3) -> Flags:
        """Return which Gaussians are nearer to a place than the clearance, or around it."""
        away = self.positions - eye
        distance = np.linalg.norm(away, axis=1)
        near: np.ndarray = distance < self.clearance
        (maybe,) = np.nonzero(~near & (distance < self.reaches))
        if len(maybe):
            candidates = self.gaussians.subset(maybe)
            whitened = np.einsum("nij,nj->ni", candidates.whitening(), away[maybe])
            near[maybe] = np.linalg.norm(whitened, axis=1) < INSIDE_SIGMAS
        return near

    def is_free(self, eye: Vector3) -> bool:
        """Return whether a camera can stand at a place."""
        return not self.is_near(eye).any() or self.surroundings(eye).is_free

    def surroundings(self, eye: Vector3) -> Surroundings:
        """Look all around from a place: six square pictures that fill the sphere."""
        near = self.is_near(eye)[:, None].astype(np.float32)
        close = self.splats._replace(near=PROBE_NEAR_SHARE * self.clearance)
        enclosed, shares = [], []
        for axis in np.concatenate([np.eye(3), -np.eye(3)]):
            face = looking_at(eye, eye + axis, np.roll(axis, 1), (FACE_PIXELS, FACE_PIXELS), 90.0)
            drawn = render_channels(close, face, near, threads=self.threads)
            enclosed.append((drawn.alpha > SURE_ALPHA).mean())
            shares.append(drawn.channels[..., 0].mean())
        return Surroundings(float(np.mean(enclosed)), float(np.mean(shares)))


def solid_centers(gaussians: Gaussians) -> Points:
    """Return the centres of the solid Gaussians, of all where too few are solid."""
    solid = gaussians.opacities >= SOLID_OPACITY
    return gaussians.positions[solid] if solid.sum() >= MIN_SIZED_GAUSSIANS else gaussians.positions


def spread_out(places: Points, count: int) -> OtherPoints:
    """Return up to `count` places: the first one, then always the one farthest from all before."""
    if not len(places):
        return places
    chosen, away = [0], np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < min(count, len(places)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return places[chosen]
