"""Viewpoints: which way is up, the place before a match, a swing around it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...base.arrays import Float64, Matrices, PlanePoints, Points, Vector3
from ...errors import InputError
from ...query import Match, Scene
from ...scene.gaussians import Gaussians
from ...scene.views import View

DISTANCE_SIZES = 2.6  # distance from a match, in its own sizes
RISE = 0.45  # height above it over that distance
MARGIN_SHARE = 0.15  # of a photo's sides, where a thing may be cut off
MIN_SIZE_SHARE = 0.04  # of a scene's radius: closer up, a small match fills the picture with noise
FOV_DEGREES = 55.0
UP_WITHOUT_VIEWS = (0.0, -1.0, 0.0)  # COLMAP's first camera, whose frame most scenes have


def up_direction(scene: Scene) -> Vector3:
    """Return the scene's upward direction, as its boxes stand; where nothing tells, that of COLMAP's first camera."""
    return np.array(UP_WITHOUT_VIEWS) if scene.up is None else scene.up


def named_up(text: str) -> Vector3:
    """Return the direction of "+z", "-y" and so on; "z" is "+z". Raises: InputError: none of these."""
    sign, letter = (text[:1], text[1:]) if text[:1] in ("+", "-") else ("+", text)
    if letter not in ("x", "y", "z"):
        raise InputError(f"up: {text}: expected one of +x -x +y -y +z -z")
    return np.eye(3)["xyz".index(letter)] * (1 if sign == "+" else -1)


def looking_at(
    eye: Vector3, target: Vector3, up: Vector3, size: tuple[int, int], fov_degrees: float = FOV_DEGREES
) -> View:
    """Return a camera at `eye` with `target` in the middle of its picture. size: width and height.

    fov_degrees: from the top to the bottom of the picture.

    Raises: InputError: eye and target are one.
    """
    ahead = target - eye
    length = np.linalg.norm(ahead)
    if not length > 0:
        raise InputError("a camera cannot look at the place where it stands")
    ahead = ahead / length
    right = np.cross(ahead, up)
    if np.linalg.norm(right) < 1e-6:  # straight up or down: any right will do
        right = np.cross(ahead, np.roll(up, 1) + 1e-3)
    right = right / np.linalg.norm(right)
    focal = size[1] / (2 * np.tan(np.radians(fov_degrees) / 2))
    return View.standing("camera", eye, np.stack([right, np.cross(ahead, right), ahead]), focal, size)


def before(match: Match, gaussians: Gaussians, views: Sequence[View], up: Vector3) -> Vector3:
    """Return a place to see a match from: on the way to a photo that shows it, so that nothing stands between.

    Of the photos that have its middle in the picture, the one taken from about the best distance; without any, a place
    a little above it.
    """
    return beside(match.center, size_in(match.extent, radius_of(gaussians)), views, up)


class Standpoints(NamedTuple):
    """Cameras as arrays, for many questions about them. sizes: width and height of their pictures."""

    centers: Points
    poses: Float64[np.ndarray, "n 4 4"]
    K: Matrices
    sizes: PlanePoints

    @classmethod
    def of(cls, views: Sequence[View]) -> "Standpoints":
        """Return the cameras of some views."""
        return cls(
            np.array([view.center for view in views], np.float64).reshape(-1, 3),
            np.array([view.cam_from_world for view in views], np.float64).reshape(-1, 4, 4),
            np.array([view.K for view in views], np.float64).reshape(-1, 3, 3),
            np.array([view.size for view in views], np.float64).reshape(-1, 2),
        )


def beside(center: Vector3, size: float, views: Sequence[View] | Standpoints, up: Vector3) -> Vector3:
    """Return a place to see something from, of a size in scene units; see `before`."""
    stands = views if isinstance(views, Standpoints) else Standpoints.of(views)
    distance = DISTANCE_SIZES * size * float(np.hypot(1, RISE))
    if not len(stands.centers):
        side = np.array([0.8, 0.5, 0.3])
        side = side - (side @ up) * up
        side = side / np.linalg.norm(side) + RISE * up
        return center + distance * side / np.linalg.norm(side)
    ways = stands.centers - center
    lengths = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
    # which views have a point in the inner part of their picture
    _, poses, K, sizes = stands
    x, y, z = (poses[:, :3, :3] @ center + poses[:, :3, 3]).T
    z = np.where(z > 0, z, np.nan)
    u = (K[:, 0, 0] * x / z + K[:, 0, 2]) / sizes[:, 0]
    v = (K[:, 1, 1] * y / z + K[:, 1, 2]) / sizes[:, 1]
    showing = (np.minimum(u, v) >= MARGIN_SHARE) & (np.maximum(u, v) <= 1 - MARGIN_SHARE)
    unfit = np.abs(np.log(lengths / distance)) + np.where(showing | ~showing.any(), 0.0, np.inf)
    best = int(unfit.argmin())
    return center + ways[best] * min(1.0, distance / lengths[best])


def size_in(extent: Vector3, radius: float) -> float:
    """Return the longest side of a box, but not less than a small part of the scene, of some radius."""
    return max(float(extent.max()), MIN_SIZE_SHARE * radius, 1e-6)


def radius_of(gaussians: Gaussians) -> float:
    """Return the median distance of the Gaussians from their middle, in scene units."""
    spread = gaussians.means.astype(np.float64)
    return float(np.median(np.linalg.norm(spread - np.median(spread, axis=0), axis=1)))


def swing(eye: Vector3, target: Vector3, up: Vector3, frames: int, turn_degrees: float = 60.0) -> list[Vector3]:
    """Return the places of a swing around `target` that begins and ends at `eye`: a loop, slow at its turns.

    Raises: InputError: fewer than two frames.
    """
    if frames < 2:
        raise InputError(f"a swing needs two frames or more, got {frames}")
    angles = np.radians(turn_degrees / 2) * np.sin(2 * np.pi * np.arange(frames) / frames)
    arm = eye - target  # turned around `up` by Rodrigues' formula
    along, across = (up @ arm) * up, np.cross(up, arm)
    return [target + (along + np.cos(angle) * (arm - along) + np.sin(angle) * across) for angle in angles]
