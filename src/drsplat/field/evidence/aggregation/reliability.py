"""Reliability of a Gaussian's feature, by the agreement of its votes and the number of their views."""

import numpy as np

from ....base.arrays import Float64
from ....kernels import weighted_rows
from ..evidence import Evidence
from .by_view import effective_views

ROWS_AT_ONCE = 8192


def resultant_lengths(evidence: Evidence, threads: int = 0) -> Float64[np.ndarray, " r"]:
    """Return the length of each row's weighted mean of unit embeddings: 1 where all votes agree, 0 without votes."""
    weights, rows = evidence.weights, len(evidence)
    # A column of ones beside the embeddings adds up the weights: a row is then (sum of W e, sum of W) but for
    # its scale, and the quotient of the two parts is the length that the kernel divides away.
    ones = np.ones((len(evidence.embeddings), 1), np.float32)
    table = np.concatenate([evidence.embeddings, ones], axis=1)
    lengths = np.zeros(rows)
    for begin in range(0, rows, ROWS_AT_ONCE):
        end = min(begin + ROWS_AT_ONCE, rows)
        csr = weights.indptr, weights.indices, weights.data
        mixed = weighted_rows(*csr, table, begin, end, threads=threads)
        totals = mixed[:, -1].astype(np.float64)
        norms = np.sqrt(np.einsum("nd,nd->n", mixed[:, :-1], mixed[:, :-1], dtype=np.float64))
        lengths[begin:end] = np.divide(norms, totals, out=np.zeros(end - begin), where=totals > 0)
    return np.minimum(lengths, 1)


def reliability(evidence: Evidence, threads: int = 0) -> Float64[np.ndarray, " r"]:
    """Return |f| N_eff / (N_eff + 1), in [0, 1); 0 without evidence. Source: NormLift (2026), reliability."""
    views = effective_views(evidence)
    return np.asarray(resultant_lengths(evidence, threads) * views / (views + 1))
