"""Which Gaussians lie next to each other."""

import numpy as np
from jaxtyping import Float, Int32
from scipy.spatial import cKDTree

NEIGHBOURS = 12
FAR = 4.0  # times the usual distance to the sixth neighbour, of the scene or of the Gaussian


def neighbours(points: Float[np.ndarray, "n 3"], threads: int = 0) -> Int32[np.ndarray, "e 2"]:
    """Pairs (a, b), a < b, of which one is among the nearest twelve of the other, and not far; ascending."""
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros((0, 2), np.int32)
    distances, found = cKDTree(points).query(points, count + 1, workers=threads or -1)
    sixth = distances[:, (count + 1) // 2]
    near = distances[:, 1:] <= FAR * np.maximum(sixth, np.median(sixth))[:, None]
    first = np.broadcast_to(np.arange(len(points))[:, None], near.shape)[near]
    second = found[:, 1:][near]
    other = first != second  # of points in one place, none may find itself first
    low, high = np.minimum(first, second)[other], np.maximum(first, second)[other]
    keys = np.sort(low.astype(np.int64) * len(points) + high)  # quicker than np.unique, which hashes
    keys = keys[np.diff(keys, prepend=-1) > 0]
    return np.stack(np.divmod(keys, len(points)), axis=1).astype(np.int32)
