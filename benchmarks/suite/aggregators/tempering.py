"""Weights of a lower power: no photo outvotes the others only because it was taken from nearby."""

from dataclasses import dataclass

import numpy as np

from drsplat.field.evidence.aggregation.entries import with_weights
from drsplat.field.evidence.evidence import Evidence


@dataclass(frozen=True)
class Tempered:
    """W_ij becomes W_ij^power: 1 is the mean, 0 counts every mask alike.

    The pixels of a mask share one embedding and so one error: ten times as many of them do not make the
    embedding ten times as good, and a Gaussian near one camera has nearly all of its pixels there.

    Source: ours.
    """

    power: float = 0.5

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:
        return with_weights(evidence, evidence.weights.data ** np.float32(self.power))
