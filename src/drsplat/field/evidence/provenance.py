"""Provenance of W's columns, view by view: what is needed to add views later, or to leave some out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.arrays import Float64, Indices, UInt8, Vector3
from ...errors import InputError
from ...scene.boxes import upward_of
from ...scene.views import View

KEY_BYTES = 16
CAMERA_NUMBERS = 18  # 3x4 pose, fx, fy, cx, cy, width, height
MAX_ABS_AXIS = 2.0  # of any number of a direction


@dataclass(frozen=True, eq=False)
class Provenance:
    """Provenance of W's columns: a row per view, in the order of `MaskIds.view_names`.

    axes: each camera's right and down, in the world; they tell what is up. keys: a hash of all that a view's columns
    are made from: its camera, its masks, the Gaussians and how pixels are sampled. isa: the instruction set that the
    weights were computed with; those of several, joined with "+". level: of the masks ("large"); None where they are
    of no folder.

    Raises: InputError: arrays that do not fit each other.
    """

    axes: Float64[np.ndarray, "v 2 3"]
    keys: UInt8[np.ndarray, "v 16"]
    isa: str
    level: str | None = None
    cameras: Float64[np.ndarray, "v 18"] | None = None

    def __post_init__(self) -> None:
        count = len(self.axes)
        for name, dtype, shape in (("axes", "float64", (count, 2, 3)), ("keys", "uint8", (count, KEY_BYTES))):
            array = getattr(self, name)
            if array.dtype != dtype or array.shape != shape:
                raise InputError(f"{name}: expected {dtype} {shape}, got {array.dtype} {array.shape}")
        if not (np.abs(self.axes) <= MAX_ABS_AXIS).all():  # NaN is not either
            raise InputError("axes: expected unit vectors")
        cameras = np.ones((count, CAMERA_NUMBERS)) if self.cameras is None else self.cameras
        fits = cameras.dtype == np.float64 and cameras.shape == (count, CAMERA_NUMBERS) and np.isfinite(cameras).all()
        if not fits or (cameras[:, 12:14] <= 0).any() or (cameras[:, 16:] < 1).any():
            raise InputError(
                f"cameras: expected {CAMERA_NUMBERS} finite numbers, with lengths and sizes above 0, for each view"
            )

    def __len__(self) -> int:
        return len(self.axes)

    @property
    def up(self) -> Vector3 | None:
        """Direction that is up in the photos (`boxes.upward`); None: they do not tell."""
        try:
            return upward_of(self.axes)
        except InputError:
            return None

    def of(self, views: Indices) -> "Provenance":
        """Return the provenance of some views, in that order."""
        cameras = None if self.cameras is None else self.cameras[views]
        return Provenance(self.axes[views], self.keys[views], self.isa, self.level, cameras)

    def views(self, names: Sequence[str]) -> list[View]:
        """Return the cameras as views without photos; none where they are unknown. names: of all views.

        Raises: InputError: a camera that is no rigid motion.
        """
        numbers = np.empty((0, CAMERA_NUMBERS)) if self.cameras is None else self.cameras
        return [_view(name, camera) for name, camera in zip(names, numbers, strict=False)]

    def with_views(self, other: "Provenance", order: Indices) -> "Provenance":
        """Return the provenance of both: the views of `other` after these, then put in `order`.

        Raises: InputError: masks of two levels.
        """
        if None not in (self.level, other.level) and self.level != other.level:
            raise InputError(f"masks of the levels {self.level} and {other.level}: register both with the same level")
        axes, keys = (np.concatenate(pair)[order] for pair in ((self.axes, other.axes), (self.keys, other.keys)))
        cameras = None
        if self.cameras is not None and other.cameras is not None:
            cameras = np.concatenate([self.cameras, other.cameras])[order]
        isas = {*self.isa.split("+"), *other.isa.split("+")}
        return Provenance(axes, keys, "+".join(sorted(isas)), self.level or other.level, cameras)


def cameras_of(views: Sequence[View]) -> Float64[np.ndarray, "v 18"]:
    """Return the numbers of each view's camera, as `Provenance.cameras` has them."""
    rows = [
        [*v.cam_from_world[:3].ravel(), v.K[0, 0], v.K[1, 1], v.K[0, 2], v.K[1, 2], v.width, v.height] for v in views
    ]
    return np.array(rows, np.float64).reshape(-1, CAMERA_NUMBERS)


def _view(name: str, numbers: Float64[np.ndarray, " 18"]) -> View:
    pose, (across, down, x, y, width, height) = numbers[:12].reshape(3, 4), numbers[12:].tolist()
    lens = np.array([[across, 0.0, x], [0.0, down, y], [0.0, 0.0, 1.0]])
    whole = np.concatenate([pose, [[0.0, 0, 0, 1]]])
    return View(name, width=int(width), height=int(height), K=lens, cam_from_world=whole)
