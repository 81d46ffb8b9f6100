"""Scores of a query, smoothed over space when it is asked; features stay as they are."""

import numpy as np
from jaxtyping import Float32, Int64
from scipy.spatial import cKDTree

from ..errors import InputError
from ..field import LanguageField
from ..gaussians import Gaussians

NEIGHBOURS, SHARE = 10, 0.5


def field_neighbours(
    field: LanguageField, gaussians: Gaussians, count: int = NEIGHBOURS, *, threads: int = 0
) -> Int64[np.ndarray, "r k"]:
    """For each row of the field the rows of the nearest Gaussians with a feature, without itself.

    Make it once for all queries: 8 count bytes per row. Fewer than `count` where the field is smaller.

    Raises: MismatchError: the field is of another scene. InputError: count < 1.
    """
    field.check_scene(gaussians)
    if count < 1:
        raise InputError(f"count: expected one neighbour or more, got {count}")
    points, rows = gaussians.means[field.gaussian_ids], np.arange(len(field))
    found = min(count, max(len(field) - 1, 0))
    if not found:
        return np.empty((len(field), 0), np.int64)
    near = cKDTree(points).query(points, k=found + 1, workers=threads or -1)[1]
    # A row is not always the first of its own neighbours: others may be at the same place.
    itself = near == rows[:, None]
    itself[~itself.any(axis=1), -1] = True
    return np.asarray(near[~itself].reshape(len(field), found), np.int64)


def smoothed(
    scores: Float32[np.ndarray, " r"],
    neighbours: Int64[np.ndarray, "r k"],
    share: float = SHARE,
) -> Float32[np.ndarray, " r"]:
    """(1 - share) s_i + share * mean of the neighbours' scores; as they are where there is no neighbour.

    Raises: InputError: a share outside [0, 1].
    Source: VALA (3DV 2026), query: share 0.5, 10 neighbours.
    """
    if not 0 <= share <= 1:
        raise InputError(f"share: expected a number from 0 to 1, got {share}")
    if not neighbours.shape[1]:
        return scores
    around = np.zeros(len(scores), np.float64)
    for column in neighbours.T:
        around += scores[column]
    mixed = (1 - share) * scores + share * around / neighbours.shape[1]
    return np.asarray(mixed, np.float32)
