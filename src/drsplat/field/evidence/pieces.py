"""Rows of W in pieces, so that tasks elsewhere read those that they need."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array, vstack

from ...base.arrays import Doubles, Indices
from ...base.contents import release
from ...base.working import Held, Work
from .evidence import csr_of

PIECE_ENTRIES = 1 << 24  # 128 MB of weights


@dataclass(frozen=True, eq=False)
class HeldRows:
    """W in pieces. starts: the first row of each, and the number of all. columns: of W."""

    pieces: list[Held]
    starts: Indices
    columns: int

    @classmethod
    def of(cls, weights: csr_array, work: Work) -> "HeldRows":
        """Keep W where the parts of `work` can have it."""
        ends = np.searchsorted(weights.indptr, np.arange(PIECE_ENTRIES, weights.indptr[-1], PIECE_ENTRIES))
        starts = np.array([0, *ends, weights.shape[0]])
        pieces = []
        for first, end in pairwise(starts.tolist()):
            begins = weights.indptr[first : end + 1]
            entries = slice(begins[0], begins[-1])
            indptr = (begins - begins[0]).astype(np.int32)  # of the kind of the columns, which SciPy else looks through
            held = {"indptr": indptr, "indices": weights.indices[entries], "data": weights.data[entries]}
            pieces.append(work.hold(held))
        return cls(pieces, starts, weights.shape[1])

    def piece(self, number: int) -> csr_array:
        arrays = self.pieces[number].arrays
        return csr_of(arrays["indptr"], arrays["indices"], arrays["data"], self.columns)

    def totals(self) -> Doubles:
        """Return the weight of each column."""
        pieces = map(self.piece, range(len(self.pieces)))
        return np.sum([np.bincount(one.indices, one.data, self.columns) for one in pieces], axis=0)

    def rows(self, numbers: Indices) -> csr_array:
        """Return some rows of W in their order."""
        order = np.argsort(numbers, kind="stable")
        ascending = numbers[order]
        parts = [csr_array((0, self.columns), dtype=np.float32)]
        for number, (begin, end) in enumerate(pairwise(np.searchsorted(ascending, self.starts).tolist())):
            if begin < end:
                piece = self.piece(number)
                parts.append(piece[ascending[begin:end] - self.starts[number]])
                release(piece.indices, piece.data)
        found = parts[-1] if len(parts) <= 2 else csr_array(vstack(parts))
        return found if (np.diff(order) == 1).all() else csr_array(found[np.argsort(order, kind="stable")])
