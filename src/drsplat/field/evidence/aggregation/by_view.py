"""Weight of each Gaussian in each photo: W with the columns of each view added up."""

from dataclasses import dataclass

import numpy as np

from ....base.arrays import Bool, Float64, Int64, Integer
from ..evidence import Evidence


@dataclass(frozen=True, eq=False)
class ViewSums:
    """Sums of W, an element per Gaussian and view with weight, in the order of W's rows, then of views.

    weights: the sum over the view's columns, in pixels. entries: how many entries of W were added up.
    """

    rows: Int64[np.ndarray, " g"]
    views: Integer[np.ndarray, " g"]
    weights: Float64[np.ndarray, " g"]
    entries: Int64[np.ndarray, " g"]

    def per_entry(self, kept: Bool[np.ndarray, " g"]) -> Bool[np.ndarray, " e"]:
        """Repeat the value of each sum for every entry of W in it."""
        return np.repeat(kept, self.entries)


def view_sums(evidence: Evidence) -> ViewSums:
    """Add up W's columns of each view; the evidence has its columns in canonical order."""
    weights = evidence.weights
    views = evidence.masks.views[weights.indices]
    first = np.empty(len(views), np.bool_)
    first[:1] = True
    np.not_equal(views[1:], views[:-1], out=first[1:])
    lengths = np.diff(weights.indptr)
    first[weights.indptr[:-1][lengths > 0]] = True
    starts = np.flatnonzero(first)
    if not len(starts):
        return ViewSums(starts, views, np.empty(0), starts)
    sums = np.add.reduceat(weights.data, starts, dtype=np.float64)
    rows = np.searchsorted(weights.indptr, starts, side="right") - 1
    return ViewSums(rows, views[starts], sums, np.diff(starts, append=len(views)))


def effective_views(evidence: Evidence) -> Float64[np.ndarray, " r"]:
    """Return N_eff = (sum_v W_v)^2 / sum_v W_v^2, the equivalent number of equal views; 0 without any.

    Source: NormLift (2026), reliability.
    """
    sums, rows = view_sums(evidence), len(evidence)
    total = np.bincount(sums.rows, sums.weights, rows)
    squares = np.bincount(sums.rows, sums.weights**2, rows)
    return np.divide(total**2, squares, out=np.zeros(rows), where=squares > 0)
