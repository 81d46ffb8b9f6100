"""Order along a Morton curve: rows that are near in space are mostly near in the order."""

import numpy as np

from ..base.arrays import AnyPoints, Array, Indices, UInt64

BITS_PER_AXIS = 21  # three times 21 fill 63
_SPREAD = (  # shift, mask: each bit of 21 to every third place
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_order(positions: AnyPoints, bits: int = BITS_PER_AXIS) -> Indices:
    """Return the order of rows along the curve through their box; rows of one cell stay in order."""
    return np.argsort(morton_codes(positions, bits), kind="stable")


def morton_codes(positions: AnyPoints, bits: int = BITS_PER_AXIS) -> UInt64[Array, " n"]:
    """Return each position's cell number along the curve; the box has 2^bits cells along its longest side."""
    low = positions.min(0, initial=np.inf)
    side = float((positions.max(0, initial=-np.inf) - low).max(initial=0.0))
    scale = (2**bits - 1) / side if side > 0 else 0.0
    codes = np.zeros(len(positions), np.uint64)
    for axis in range(3):
        cells = ((positions[:, axis].astype(np.float64) - low[axis]) * scale).astype(np.uint64)
        codes |= _spread(cells) << np.uint64(axis)
    return codes


def _spread(cells: UInt64[Array, " n"]) -> UInt64[Array, " n"]:
    for shift, mask in _SPREAD:
        cells = (cells | cells << np.uint64(shift)) & np.uint64(mask)
    return cells
