"""Gaussians that hardly anything was seen of lose their feature."""

from dataclasses import dataclass

import numpy as np

from drsplat.field.evidence.aggregation.entries import with_weights
from drsplat.field.evidence.evidence import Evidence


@dataclass(frozen=True)
class Pruned:
    """Drop rows whose total weight is under `least`, or under `share` of the median of rows.

    Source: VALA (3DV 2026), pruning.
    """

    least: float = 1e-5  # of one pixel
    share: float = 0.01

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:
        weights = evidence.weights
        totals = np.asarray(weights.sum(axis=1, dtype=np.float64))
        seen = totals > 0
        if not seen.any():
            return evidence
        kept = totals >= max(self.least, self.share * float(np.median(totals[seen])))
        per_entry = np.repeat(kept, np.diff(weights.indptr))
        return with_weights(evidence, np.where(per_entry, weights.data, np.float32(0)))
