"""Cameras that a viewer begins with."""

from collections.abc import Sequence

import numpy as np

from ...authoring.filming.looking import Vector
from ...scene.views import View
from .shown import RADIUS, Frame

OUTSIDE_RADII = 2.7  # a ball of one radius fits into 55 degrees from 2.2 on


def first_look(views: Sequence[View], frame: Frame, up: Vector) -> tuple[Vector, Vector]:
    """Return where to begin and what to look at: from one of the photos, else from outside, with all in the picture."""
    if not views:
        side = np.array([0.8, 0.5, 0.3])
        side = side - (side @ up) * up + 0.4 * up
        return frame.center + OUTSIDE_RADII * RADIUS / frame.scale * side / np.linalg.norm(side), frame.center
    view = views[len(views) // 2]
    ahead = view.cam_from_world[2, :3]
    reach = max(float(ahead @ (frame.center - view.center)), 1 / frame.scale)
    return view.center, view.center + reach * ahead
