"""Where the photographer of the demo stands."""

import numpy as np
from world.cameras import look_at

from drsplat.scene.views import View

Number = int | float
Point = tuple[Number, Number, Number] | np.ndarray


def walk(num_views: int, width: int, height: int) -> list[View]:
    """Two thirds from an arc outside the open sides, one third from within the room."""
    num_outside = -(-num_views * 2 // 3)
    outside = [_outside(i / max(1, num_outside - 1), i) for i in range(num_outside)]
    inside = [_inside(i / max(1, num_views - num_outside - 1)) for i in range(num_views - num_outside)]
    poses = [(eye, at, 58.0) for eye, at in outside] + [(eye, at, 66.0) for eye, at in inside]
    return [look_at(eye, at, (width, height), fov, f"photo_{i:03d}.jpg") for i, (eye, at, fov) in enumerate(poses)]


def _outside(t: Number, index: int) -> tuple[Point, Point]:
    """An arc around the room's middle, at three heights in turn."""
    angle, height = np.radians(-128 + 126 * t), (1.15, 1.75, 2.4)[index % 3]
    eye = (2.1 + 3.6 * np.cos(angle), 2.1 + 3.9 * np.sin(angle), height)
    return eye, (2.05, 2.15, 0.75)


def _inside(t: Number) -> tuple[Point, Point]:
    """A walk around the table, looking across it."""
    angle = np.radians(200 - 400 * t)
    eye = (2.25 + 1.35 * np.cos(angle), 1.75 + 0.95 * np.sin(angle), 1.35 + 0.15 * np.sin(3 * angle))
    ahead = (2.25 - 0.4 * np.cos(angle), 1.95 - 0.4 * np.sin(angle), 0.5)
    return eye, ahead
