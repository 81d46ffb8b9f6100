"""A scene as leaves of a tree of levels of detail: runs of neighbouring Gaussians that are read one at a time."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from ..base.arrays import Float64
from ..scene.gaussians import Gaussians
from ..scene.morton import morton_order
from .tiles import Tiles
from .writable import refuse_unwritable

Leaf = Callable[[], Gaussians]
"""Reads the Gaussians of a leaf."""


class Leaves(NamedTuple):
    """Leaves in order, neighbours next to each other. middle: of the box of all centres, in the world."""

    leaves: list[Leaf]
    middle: Float64[np.ndarray, " 3"]


def leaves_of(source: Gaussians | Tiles, rows: int) -> Leaves:
    """Split a scene into leaves. rows: of a leaf at most, of a scene that is not cut into tiles already.

    Raises: InputError: no Gaussians, or some that no file could give back.
    """
    if isinstance(source, Tiles):
        low, high = np.min([t.low for t in source.tiles], axis=0), np.max([t.high for t in source.tiles], axis=0)
        return Leaves([partial(source.tile, tile) for tile in source.tiles], source.origin + (low + high) / 2)
    refuse_unwritable(source)
    order = morton_order(source.means.astype(np.float64))
    runs = [order[begin : begin + rows] for begin in range(0, len(order), rows)]
    middle = source.origin + (source.means.min(0).astype(np.float64) + source.means.max(0)) / 2
    return Leaves([partial(source.subset, run) for run in runs], middle)
