"""Pairs of photos to compare: their cameras are near each other and look the same way."""

from collections.abc import Sequence

import numpy as np

from ...base.arrays import Float64, Integer
from ...scene.views import View

NEIGHBOUR_RANKS = (1, 2, 3, 5, 8, 12, 18)
"""Ranks of the neighbours to compare: the nearest share most, farther ones give depth."""
MAX_TURN_DEGREES = 60.0  # between two cameras' directions; SIFT does not match beyond


def neighbours(views: Sequence[View]) -> Integer[np.ndarray, "p 2"]:
    """Return the sorted pairs of indices of the views to compare, the smaller index first."""
    centers = np.array([view.center for view in views])
    directions = np.array([view.cam_from_world[2, :3] for view in views])
    pairs: set[tuple[int, int]] = set()
    for index in range(len(views)):
        by_distance = _by_distance(index, centers, directions)
        for rank in NEIGHBOUR_RANKS:
            if rank <= len(by_distance):
                other = int(by_distance[rank - 1])
                pairs.add((min(index, other), max(index, other)))
    return np.array(sorted(pairs), np.int64).reshape(-1, 2)


def _by_distance(
    index: int, centers: Float64[np.ndarray, "n 3"], directions: Float64[np.ndarray, "n 3"]
) -> Integer[np.ndarray, " m"]:
    """Return the other cameras that look about the same way, nearest first."""
    alike = directions @ directions[index] > np.cos(np.radians(MAX_TURN_DEGREES))
    alike[index] = False
    others = np.flatnonzero(alike)
    distances = np.linalg.norm(centers[others] - centers[index], axis=1)
    return others[np.argsort(distances, kind="stable")]
