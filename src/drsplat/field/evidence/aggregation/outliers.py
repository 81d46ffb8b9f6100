"""Rejection of votes that disagree with all the others of their Gaussian."""

from dataclasses import dataclass

import numpy as np

from ....base.arrays import DoubleRows, Doubles, OtherEmbeddings
from ..evidence import Evidence
from .entries import RowBlock, reweighted

MAD_OF_NORMAL = 1.4826  # times the median absolute deviation is the standard deviation of a normal law


@dataclass(frozen=True)
class OutlierRejection:
    """Drop votes whose agreement with the rest is far below that of the row's other votes.

    Agreement of a vote: its cosine with the weighted sum of the row's other votes. It is dropped where it is
    more than `deviations` robust standard deviations, and more than `least`, below the row's weighted
    median. A row of one or two votes has no majority and stays as it is.

    Source: ReLaGS (CVPR 2026) rejects by z-scores at 3; those of r votes cannot reach 3 for r < 11, so
    that the median and its absolute deviation take the place of mean and standard deviation.
    """

    deviations: float = 3.0
    least: float = 0.05

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:

        def rule(block: RowBlock) -> DoubleRows:
            agreement = agreements(block, evidence.embeddings)
            middle = weighted_medians(agreement, block.weights)
            spread = MAD_OF_NORMAL * weighted_medians(np.abs(agreement - middle[:, None]), block.weights)
            least = middle - np.maximum(self.least, self.deviations * spread)
            many = block.filled.sum(1) > 2
            return np.where((agreement < least[:, None]) & many[:, None], 0, block.weights)

        return reweighted(evidence, rule, threads)


def agreements(block: RowBlock, table: OtherEmbeddings) -> DoubleRows:
    """Return the cosine of each vote with the weighted sum of the row's others; 1 where there is no other."""
    total = np.zeros((len(block.weights), table.shape[1]), np.float32)
    for k, rows in enumerate(block.active):
        f = block.embeddings(table, k)
        f *= block.weights[:rows, k, None].astype(np.float32)
        total[:rows] += f
    cosines = np.zeros(block.weights.shape)
    for k, rows in enumerate(block.active):
        cosines[:rows, k] = np.einsum("nd,nd->n", block.embeddings(table, k), total[:rows])
    w, square = block.weights, np.einsum("nd,nd->n", total, total).astype(np.float64)[:, None]
    others = square - 2 * w * cosines + w**2
    alone = others <= 1e-6 * square  # what rounding leaves of nothing
    return np.where(alone, 1.0, (cosines - w) / np.sqrt(np.where(alone, 1.0, others)))


def weighted_medians(values: DoubleRows, weights: DoubleRows) -> Doubles:
    """Return each row's weighted median: the lowest value that, with all lower ones, has half the weight."""
    order = np.argsort(np.where(weights > 0, values, np.inf), axis=1, kind="stable")
    held = np.cumsum(np.take_along_axis(weights, order, 1), axis=1)
    first = (held >= held[:, -1:] / 2).argmax(1)
    at = np.take_along_axis(order, first[:, None], 1)
    return np.take_along_axis(values, at, 1)[:, 0]
