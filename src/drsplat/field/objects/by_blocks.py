"""Objects of scenes that are too large for one forest: a forest for each block, and one of all of them.

W, places -> blocks               of a few million weights, each with what is around it
a block   -> its nodes            in the memory of that block, by whoever has time
all nodes -> nodes of the scene   what two blocks see of one region is told by the rows that both look at
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.arrays import Bool, Float32, Float64, Int64
from ...kernels import MergeRule
from ..evidence.aggregation.entries import row_chunks
from ..evidence.evidence import Evidence
from .block_nodes import BlockNodes, nodes_of
from .blocks import Block, BlockRows, MaskColumns, in_blocks, rows_around
from .uniting import Masses

BLOCK_WEIGHTS = 8_000_000  # of a block, without what is around it

Work = Callable[["Division"], Iterable[BlockNodes]]
"""Finder of the nodes of all blocks of a scene, in their order."""


@dataclass(frozen=True, eq=False)
class Totals:
    """Sums of W over the columns that are looked at.

    rows, counts: weight and number of weights of each row. masks: weight of each mask. sights: views that see a row, of
    all rows together.
    """

    rows: Float64[np.ndarray, " r"]
    counts: Int64[np.ndarray, " r"]
    masks: Float64[np.ndarray, " m"]
    sights: int

    @classmethod
    def of(cls, evidence: Evidence, kept: Bool[np.ndarray, " m"]) -> "Totals":
        """Add up W in one pass. kept: columns that are looked at."""
        weights, views, count = evidence.weights, evidence.masks.views, len(evidence)
        rows, counts, masks, sights = np.zeros(count), np.zeros(count, np.int64), np.zeros(len(views)), 0
        for part in row_chunks(weights):
            starts = weights.indptr[part.start : part.stop + 1].astype(np.int64)
            columns, data = weights.indices[starts[0] : starts[-1]], weights.data[starts[0] : starts[-1]]
            held = kept[columns] & (data > 0)
            at = np.repeat(np.arange(part.stop - part.start), np.diff(starts))[held]
            columns, data = columns[held], data[held]
            rows[part] = np.bincount(at, data, part.stop - part.start)
            counts[part] = np.bincount(at, minlength=part.stop - part.start)
            masks += np.bincount(columns, data, len(masks))
            seen = at * np.int64(len(evidence.masks.view_names)) + views[columns]
            sights += int(np.count_nonzero(np.diff(np.sort(seen), prepend=-1)))
        return cls(rows, counts, masks, sights)


@dataclass(frozen=True, eq=False)
class Division:
    """A scene in blocks.

    points: places of the rows. kept: columns that are looked at. embeddings: of all masks, along few directions.
    """

    evidence: Evidence
    points: Float32[np.ndarray, "r 3"]
    kept: Bool[np.ndarray, " m"]
    totals: Totals
    embeddings: Float32[np.ndarray, "m k"]
    thresholds: tuple[float, ...]
    rule: MergeRule

    @cached_property
    def blocks(self) -> list[Block]:
        """The blocks, in an order that only places and weights decide."""
        return in_blocks(self.points, self.totals.counts, BLOCK_WEIGHTS)

    @property
    def masses(self) -> Masses:
        return Masses(self.totals.rows, self.totals.masks, self.evidence.masks.views, self.rule.far)

    def rows(self, block: Block) -> BlockRows:
        """Return what there is to know of a block."""
        masks = MaskColumns(self.kept, self.totals.masks, self.evidence.masks.views, self.embeddings)
        return rows_around(block, self.points, self.evidence.weights, self.totals.rows, masks)


def at_once(division: Division, threads: int = 0) -> Iterable[BlockNodes]:
    """Yield the nodes of all blocks: this process, one after another."""
    for block in division.blocks:
        yield nodes_of(division.rows(block), division.thresholds, division.rule, threads)
