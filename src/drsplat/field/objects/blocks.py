"""Blocks of a scene that is too large to be looked at as a whole, each with what lies around it.

Where a block ends is told by places and weights alone, not by tiles, workers or the order of rows.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Bool, Float32, Float64, Int32, Int64, Integer
from ...base.contents import release
from ...scene.morton import morton_codes

SURROUNDINGS_SHARE = 0.3  # of a block's longest side
BULK_QUANTILES = (0.01, 0.99)  # of places: a side is measured between them, without strays
CURVE_BITS = 10  # of each coordinate
ROWS_AT_ONCE = 1 << 20

Points = Float32[np.ndarray, "n 3"]


class Block(NamedTuple):
    """A box that ends nowhere at the sides of the scene. around: how far its surroundings reach beyond it."""

    low: Float64[np.ndarray, " 3"]
    high: Float64[np.ndarray, " 3"]
    around: float

    def away(self, points: Points) -> Float64[np.ndarray, " n"]:
        """Return how far points are from the block, along the axis of the largest distance; 0 within, its end is out.

        In parts of `around`: surroundings reach up to 1.
        """
        outside = np.maximum(np.maximum(self.low - points, points - self.high), 0).max(axis=1)
        ends = (points >= self.high).any(axis=1) & (outside == 0)
        return np.asarray(np.where(ends, np.finfo(np.float64).tiny, outside / self.around))


class BlockRows(NamedTuple):
    """Rows of W in a block and around it, in an order that does not depend on that of the scene's rows.

    rows: of the field. away: as of `Block`. points: places. indptr, indices, data: W, whose columns are `columns` of
    the scene's masks, with their views, their weights in the whole scene, and embeddings along few directions.
    """

    rows: Int64[np.ndarray, " n"]
    away: Float64[np.ndarray, " n"]
    points: Points
    indptr: Int64[np.ndarray, " n1"]
    indices: Int32[np.ndarray, " e"]
    data: Float32[np.ndarray, " e"]
    columns: Int32[np.ndarray, " m"]
    views: Int32[np.ndarray, " m"]
    masses: Float64[np.ndarray, " m"]
    embeddings: Float32[np.ndarray, "m k"]

    @property
    def weights(self) -> csr_array:
        return csr_array((self.data, self.indices, self.indptr), shape=(len(self.rows), len(self.columns)))


class MaskColumns(NamedTuple):
    """Columns of W. kept: those that are looked at. masses: weights in the whole scene. views: never falling."""

    kept: Bool[np.ndarray, " m"]
    masses: Float64[np.ndarray, " m"]
    views: Int32[np.ndarray, " m"]
    embeddings: Float32[np.ndarray, "m k"]


def in_blocks(points: Points, counts: Integer[np.ndarray, " n"], most: int) -> list[Block]:
    """Cut a scene in halves, at medians along its longest side, until no block has more than `most` weights.

    counts: weights of each point. A block whose points are all in one place stays as it is.
    """
    blocks = []
    waiting = [(np.arange(len(points)), np.full(3, -np.inf), np.full(3, np.inf))]
    while waiting:
        rows, low, high = waiting.pop()
        sides = np.subtract(*np.quantile(points[rows], BULK_QUANTILES[::-1], axis=0)) if len(rows) else np.zeros(3)
        axis = int(sides.argmax())
        middle = np.median(points[rows, axis]) if len(rows) else 0.0
        below = points[rows, axis] < middle
        if int(counts[rows].sum(dtype=np.int64)) <= most or not below.any():
            blocks.append(Block(low, high, max(SURROUNDINGS_SHARE * float(sides[axis]), 1e-9)))
            continue
        upper, lower = low.copy(), high.copy()
        upper[axis] = lower[axis] = middle
        waiting += [(rows[~below], upper, high), (rows[below], low, lower)]
    return blocks


def rows_around(
    block: Block, points: Points, weights: csr_array, sums: Float64[np.ndarray, " n"], masks: MaskColumns
) -> BlockRows:
    """Return the rows of W in a block and around it. sums: the weight of each row."""
    parts = []
    for begin in range(0, len(points), ROWS_AT_ONCE):
        parts.append(begin + np.flatnonzero(block.away(points[begin : begin + ROWS_AT_ONCE]) <= 1))
    rows = np.concatenate(parts or [np.empty(0, np.int64)])
    rows = rows[_placed_order(points[rows], sums[rows])]
    matrix = csr_array(weights[rows])
    release(weights.indices, weights.data)
    held = masks.kept[matrix.indices] & (matrix.data > 0)
    starts = np.append(0, np.cumsum(held))[matrix.indptr]
    columns, indices = np.unique(matrix.indices[held], return_inverse=True)
    return BlockRows(
        rows, block.away(points[rows]), points[rows], starts.astype(np.int64), indices.astype(np.int32),
        matrix.data[held], columns.astype(np.int32), masks.views[columns], masks.masses[columns],
        masks.embeddings[columns],
    )  # fmt: skip


def _placed_order(points: Points, sums: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Return an order along a curve that only places decide, and sums of weights where places are equal."""
    if not len(points):
        return np.empty(0, np.int64)
    codes = morton_codes(np.clip(points, *np.quantile(points, BULK_QUANTILES, axis=0)), CURVE_BITS)
    return np.lexsort((sums, points[:, 2], points[:, 1], points[:, 0], codes))
