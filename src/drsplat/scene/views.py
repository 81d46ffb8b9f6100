"""Posed photos."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.arrays import Matrix3, Matrix4, Vector3
from ..errors import InputError

PHOTOS, RENDERINGS = "photos", "renderings"
MAX_ROUNDING_SHARE = 0.05  # of a side: rounding may change a scaled raster by this


@dataclass(frozen=True, eq=False)
class View:
    """One pinhole camera: x_cam = cam_from_world @ x_world, OpenCV axes (+x right, +y down, +z forward).

    name: image file name relative to the image folder, with suffix; views are matched to features by it.
    K: 3x3 intrinsics in pixels of (width, height); the centre of pixel (0, 0) is at (0.5, 0.5).
    image_path: the photo, or None where it is not at hand.
    distortion: OpenCV coefficients (k1, k2, p1, p2) of the *photo on disk*, or None. K and every
    kernel are of the undistorted pinhole; `load_image` undoes the distortion.
    mask_path: picture of which pixels of the photo are used: white ones, with mask_inverted black ones; None: all.
    time: when the photo was taken, in the unit of a moving scene's times; None: unknown, or all stands still.
    rendered_from: scene that the picture is a rendering of, its name and fingerprint; empty for a photo.

    Raises: InputError: a singular K, a pose that is no rigid motion, an empty raster, or a time that is not finite.
    """

    name: str
    K: Matrix3
    cam_from_world: Matrix4
    width: int
    height: int
    image_path: Path | None = None
    distortion: tuple[float, float, float, float] | None = None
    time: float | None = None
    mask_path: Path | None = None
    mask_inverted: bool = False
    rendered_from: str = ""

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError(f"view '{self.name}': empty raster {self.width}x{self.height}")
        for label, matrix, shape in (("K", self.K, (3, 3)), ("cam_from_world", self.cam_from_world, (4, 4))):
            if matrix.shape != shape or not np.isfinite(matrix).all():
                raise InputError(f"view '{self.name}': {label} must be a finite {shape} matrix")
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0):
            raise InputError(f"view '{self.name}': focal lengths must be positive, got {self.K[0, 0]}, {self.K[1, 1]}")
        if self.time is not None and not abs(self.time) < np.inf:
            raise InputError(f"view '{self.name}': expected a finite time, got {self.time}")
        rotation = self.cam_from_world[:3, :3]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
            raise InputError(f"view '{self.name}': cam_from_world is not a rigid motion (check scale and handedness)")

    def __repr__(self) -> str:
        place = ", ".join(f"{x:.4g}" for x in self.center)
        return f"View('{self.name}', {self.width}x{self.height} at ({place}))"

    @classmethod
    def standing(
        cls, name: str, eye: Vector3, axes: Matrix3, focal: float,
        size: tuple[int, int],
    ) -> "View":  # fmt: skip
        """Return a camera at a place. axes: right, down and ahead. focal, size (across and down): pixels."""
        pose = np.eye(4)
        pose[:3, :3] = axes
        pose[:3, 3] = -axes @ eye
        width, height = size
        return cls(name, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), pose, width, height)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.width, self.height

    @property
    def center(self) -> Vector3:
        """Camera centre in world coordinates."""
        return -self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3]

    def relative_to(self, origin: Vector3) -> "View":
        """Return the camera in a world whose zero is at `origin`; the same object if `origin` is zero."""
        if not origin.any():
            return self
        pose = self.cam_from_world.copy()
        pose[:3, 3] += pose[:3, :3] @ origin
        return replace(self, cam_from_world=pose)

    def resized(self, width: int, height: int) -> "View":
        """Return the camera on another raster: K and size scale together."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def limited(self, max_side: float | int | None) -> "View":
        """Return the view with its longer side at most `max_side` pixels, at the same aspect ratio; None: as is."""
        scale = (max_side or np.inf) / max(self.size)
        if scale >= 1:
            return self
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))


def pictures_kind(sources: Iterable[str]) -> str:
    """Return what pictures are: "photos", "renderings" or "photos and renderings".

    sources: `rendered_from` of each.
    """
    kinds = {bool(source) for source in sources}
    return RENDERINGS if kinds == {True} else f"{PHOTOS} and {RENDERINGS}" if True in kinds else PHOTOS


def scenes_rendered(sources: Iterable[str]) -> list[str]:
    """Return the scenes that some pictures are renderings of, sorted. sources: `rendered_from` of each."""
    return sorted({*sources} - {""})


def same_aspect(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether one raster (width, height) is the other scaled, to a whole pixel either way.

    On a side of few pixels the tolerance is a twentieth of it.
    """
    (width, height), (wide, high) = sorted((one, other))  # rounding took place on the smaller one
    down, across = abs(height - high * width / wide), abs(width - wide * height / high)
    return down <= min(1, MAX_ROUNDING_SHARE * height) or across <= min(1, MAX_ROUNDING_SHARE * width)
