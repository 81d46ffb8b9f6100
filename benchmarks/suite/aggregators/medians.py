"""Medians of a Gaussian's votes on the unit sphere, as other weights of the same entries."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from drsplat.field.evidence.aggregation.entries import RowBlock, reweighted
from drsplat.field.evidence.evidence import Evidence


@dataclass(frozen=True)
class CosineMedian:
    """z <- normalise(z + eta (f - <f, z> z)) with eta = w / (w + weight so far), vote by vote.

    Votes come by view name, then mask id, and the first is the first z. What comes out is a sum of the
    votes with positive factors: those are the new weights, scaled to the row's old sum.

    Source: VALA (3DV 2026), streaming cosine median.  Twin: tests/project/test_benchmark_aggregators.py::slow_median.
    """

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:
        table = evidence.embeddings
        return reweighted(evidence, lambda block: median_weights(block, table), threads)


def median_weights(block: RowBlock, table: Float32[np.ndarray, "m d"]) -> Float64[np.ndarray, "n k"]:
    """The factors of the votes in the streaming median."""
    added, kept = np.zeros(block.weights.shape), np.ones(block.weights.shape)
    added[:, 0] = 1
    z, total = block.embeddings(table, 0), block.weights[:, 0].copy()
    for k, rows in enumerate(block.active[1:], 1):
        f, w, at = block.embeddings(table, k), block.weights[:rows, k], z[:rows]
        eta = w / (total[:rows] + w)
        cosine = np.einsum("nd,nd->n", f, at).astype(np.float64)
        # the step is at right angles to z, so that its length follows from those of f and z
        length = np.sqrt(1 + eta**2 * np.maximum(0, np.einsum("nd,nd->n", f, f) - cosine**2))
        kept[:rows, k], added[:rows, k] = (1 - eta * cosine) / length, eta / length
        at *= kept[:rows, k, None].astype(np.float32)
        f *= added[:rows, k, None].astype(np.float32)
        at += f
        total[:rows] += w
    later = np.cumprod(kept[:, ::-1], axis=1)[:, ::-1]
    added[:, :-1] *= later[:, 1:]
    return np.asarray(added * (block.weights.sum(1) / added.sum(1))[:, None])
