"""Trust in masks: those that disagree with the other photos of the same Gaussians count less."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ....base.arrays import DoubleRows, Doubles
from ..evidence import Evidence
from .entries import PASS_ENTRIES, RowBlock, entry_values, row_chunks, view_runs, with_weights
from .outliers import agreements

PARTS_PER_PIXEL = float(1 << 28)  # sums of 2^53 of them are exact, 33 million pixels


@dataclass(frozen=True)
class MaskTrust:
    """Multiply W_ij by t_iv, the trust in the masks of photo v, that of mask j, in row i.

    trust of a mask: exp(sharpness * surplus). surplus: its agreement with the other votes of a Gaussian minus
    the mean agreement of that Gaussian's votes, averaged over its Gaussians by W. So a mask that is called
    something else than the same Gaussians are in other photos is trusted less, whatever it says, and a thing
    that is hard to embed is not trusted less than its easy background. t_iv: the mean trust of v's masks in
    row i, weighted by W; votes of one photo keep their proportions, so that an edge stays where it is.

    Source: ours, in the manner of Dawid and Skene 1979, who weigh observers by how they agree with the others.
    Twin: tests/field/test_aggregation.py::slow_trust.
    """

    sharpness: float = 4.0

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:
        return self.weighed(evidence, self.trust(tally(evidence, threads)))

    def trust(self, counted: "Tally") -> Doubles:
        """Return the trust in each mask. counted: over all rows."""
        none = np.zeros(len(counted.weights))
        means = np.divide(counted.surpluses, counted.weights, out=none, where=counted.weights > 0)
        return np.exp(self.sharpness * means)

    def weighed(self, evidence: Evidence, trust: Doubles) -> Evidence:
        """Return the evidence of some rows, weighed by the trust in masks; a row depends on itself alone."""
        weights, views = evidence.weights, evidence.masks.views
        changed = np.empty(len(weights.data), np.float32)
        for rows in row_chunks(weights):
            entries = slice(weights.indptr[rows.start], weights.indptr[rows.stop])
            columns = weights.indices[entries]
            runs = view_runs(views[columns], weights.indptr[rows.start : rows.stop + 1] - entries.start)
            if len(columns):  # multiply by the mean trust of each photo's masks in each row
                votes = weights.data[entries]
                held = np.add.reduceat(votes.astype(np.float64), runs)
                trusted = np.add.reduceat(votes * trust[columns], runs)
                mean = np.divide(trusted, held, out=np.zeros(len(runs)), where=held > 0)
                changed[entries] = votes * np.repeat(mean, np.diff(np.append(runs, len(votes))))
        return with_weights(evidence, changed)


class Tally(NamedTuple):
    """Surpluses of masks by weight, and weights, summed over rows.

    Whole numbers of 1 / PARTS_PER_PIXEL pixels: sums of parts of W, in any order, have the same bits.
    """

    surpluses: Doubles
    weights: Doubles


def tally(evidence: Evidence, threads: int = 0) -> Tally:
    """Add up how much better each mask agrees with the rest than its Gaussians' votes do on average."""

    def surplus(block: RowBlock) -> DoubleRows:
        agreement = agreements(block, evidence.embeddings)
        level = _in_order(block.weights * agreement) / _in_order(block.weights)
        return agreement - level[:, None]

    weights, entries = evidence.weights, entry_values(evidence, surplus, threads)
    count = weights.shape[1]
    total, held = np.zeros(count), np.zeros(count)
    for begin in range(0, len(entries), PASS_ENTRIES):
        part = slice(begin, begin + PASS_ENTRIES)
        columns, w = weights.indices[part], weights.data[part].astype(np.float64)
        total += np.bincount(columns, np.rint(w * entries[part] * PARTS_PER_PIXEL), count)
        held += np.bincount(columns, np.rint(w * PARTS_PER_PIXEL), count)
    return Tally(total, held)


def _in_order(values: DoubleRows) -> Doubles:
    """Return the sum of each row, added up from its beginning: zeros at its end change no bit."""
    return np.cumsum(values, axis=1)[:, -1]
