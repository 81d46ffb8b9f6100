"""Choice of the pairs of photos to match: all of few photos; neighbours in order, place and looks of many.

The number of all pairs grows with the square of the photos; that of these pairs grows with their number.
"""

from collections.abc import Iterator

import numpy as np

from ...base.arrays import Float32, Float64

MAX_EXHAUSTIVE_PHOTOS = 150  # 11,175 pairs
MAX_EXHAUSTIVE_NUMBERED_PHOTOS = 40  # their order says which overlap
NEIGHBOURS_IN_ORDER = 12
NEIGHBOURS_IN_PLACE = 24
NEIGHBOURS_IN_LOOKS = 20
NUMBERED_NEIGHBOURS_IN_LOOKS = 8  # for loops
_BLOCK_ROWS = 512


def all_pairs(count: int) -> set[tuple[int, int]]:
    """Return each pair (i, j), i < j, of `count` photos."""
    return {(i, j) for i in range(count) for j in range(i + 1, count)}


def pairs_in_order(count: int) -> set[tuple[int, int]]:
    """Return pairs of photos that were taken soon after each other, and fewer pairs further apart."""
    steps = [*range(1, NEIGHBOURS_IN_ORDER + 1)]
    while steps[-1] * 2 < count:
        steps.append(steps[-1] * 2)
    return {(i, i + step) for step in steps for i in range(count - step)}


def pairs_in_place(positions: Float64[np.ndarray, "n 3"]) -> set[tuple[int, int]]:
    """Return pairs of photos that were taken near each other; rows of NaN have no place."""
    from scipy.spatial import KDTree

    placed = np.flatnonzero(np.isfinite(positions).all(1))
    if len(placed) < 2:
        return set()
    count = min(NEIGHBOURS_IN_PLACE + 1, len(placed))
    _, near = KDTree(positions[placed]).query(positions[placed], k=count)
    return _ordered(placed.repeat(count), placed[near].reshape(-1))


def pairs_in_looks(looks: Float32[np.ndarray, "n d"], count: int = NEIGHBOURS_IN_LOOKS) -> set[tuple[int, int]]:
    """Return pairs of photos that look alike. looks: unit vectors; rows of zeros look like nothing."""
    count = min(count + 1, len(looks))
    pairs: set[tuple[int, int]] = set()
    for start, block in _blocks(looks):
        alike = block @ looks.T
        best = np.argpartition(-alike, count - 1, axis=1)[:, :count]
        rows, columns = np.repeat(np.arange(len(block)), count), best.reshape(-1)
        similar = alike[rows, columns] > 0
        pairs |= _ordered(start + rows[similar], columns[similar])
    return pairs


def _blocks(looks: Float32[np.ndarray, "n d"]) -> Iterator[tuple[int, Float32[np.ndarray, "r d"]]]:
    for start in range(0, len(looks), _BLOCK_ROWS):
        yield start, looks[start : start + _BLOCK_ROWS]


def _ordered(first: np.ndarray, second: np.ndarray) -> set[tuple[int, int]]:
    low, high = np.minimum(first, second), np.maximum(first, second)
    apart = low < high
    return set(zip(low[apart].tolist(), high[apart].tolist(), strict=True))
