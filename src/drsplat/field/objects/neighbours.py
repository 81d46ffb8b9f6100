"""Which Gaussians lie next to each other, and an order in which neighbours are near."""

import numpy as np
from scipy.spatial import cKDTree

from ...base.arrays import Float, Float64, Int32, Int64
from ...scene.morton import morton_order

NUM_NEIGHBOURS = 12
MAX_USUAL_DISTANCES = 4.0  # to the sixth neighbour, of the scene or of the Gaussian

POINTS_AT_ONCE = 1 << 16

CURVE_BITS = 10  # of each coordinate


def along_a_curve(points: Float[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return the rows of points in Morton order: what is near in space then mostly lies near in memory too."""
    if not len(points):
        return np.zeros(0, np.int64)
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    return morton_order(np.clip(points, low, high), CURVE_BITS)


def neighbours(points: Float[np.ndarray, "n 3"], threads: int = 0) -> Int32[np.ndarray, "e 2"]:
    """Return the pairs (a, b), a < b, of which one is among the nearest twelve of the other, and not far; ascending."""
    count = min(NUM_NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros((0, 2), np.int32)
    distances, found = _nearest(points, count, threads)
    sixth = distances[:, (count + 1) // 2 - 1]
    reach = MAX_USUAL_DISTANCES * np.maximum(sixth, np.median(sixth))
    keys = np.concatenate([_keys(found, distances, reach, begin) for begin in range(0, len(points), POINTS_AT_ONCE)])
    del distances, found
    keys.sort()  # quicker than np.unique, which hashes
    keys = keys[np.append(True, keys[1:] != keys[:-1])] if len(keys) else keys
    edges = np.empty((len(keys), 2), np.int32)
    np.floor_divide(keys, len(points), out=edges[:, 0], casting="unsafe")
    np.remainder(keys, len(points), out=edges[:, 1], casting="unsafe")
    return edges


def _nearest(
    points: Float[np.ndarray, "n 3"], count: int, threads: int
) -> tuple[Float64[np.ndarray, "n k"], Int32[np.ndarray, "n k"]]:
    """Return distances and rows of each point's nearest but the first, which mostly is itself, in blocks."""
    tree = cKDTree(points)
    distances, found = np.empty((len(points), count)), np.empty((len(points), count), np.int32)
    for begin in range(0, len(points), POINTS_AT_ONCE):
        rows = slice(begin, begin + POINTS_AT_ONCE)
        far, which = tree.query(points[rows], count + 1, workers=threads or -1)
        distances[rows], found[rows] = far[:, 1:], which[:, 1:]
    return distances, found


def _keys(
    found: Int32[np.ndarray, "n k"], distances: Float64[np.ndarray, "n k"], reach: Float64[np.ndarray, " n"], begin: int
) -> Int64[np.ndarray, " p"]:
    """Return a number for each pair of neighbours of some rows, the same whichever of the two it comes from."""
    rows = slice(begin, begin + POINTS_AT_ONCE)
    near = distances[rows] <= reach[rows, None]
    first = np.broadcast_to(np.arange(begin, begin + len(near))[:, None], near.shape)[near]
    second = found[rows][near].astype(np.int64)
    other = first != second  # of points in one place, none may find itself first
    low, high = np.minimum(first, second)[other], np.maximum(first, second)[other]
    return np.asarray(low * len(found) + high)
