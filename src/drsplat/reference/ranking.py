"""The twin of `kernels.ranking`: every score of a row is sorted anew."""

import numpy as np

from ..arrays import Float, Integer


def keep_best(
    scores: Float[np.ndarray, "r t"], names: Integer[np.ndarray, "r t"], found: Float[np.ndarray, "c r"], first: int
) -> tuple[Float[np.ndarray, "r t"], Integer[np.ndarray, "r t"]]:
    """Return the best of both, highest first, and their names; of equal ones the earlier."""
    new = np.broadcast_to(np.arange(first, first + len(found)), found.T.shape)
    both, every = np.concatenate([scores, found.T], axis=1), np.concatenate([names, new], axis=1)
    order = np.argsort(-both, axis=1, kind="stable")[:, : scores.shape[1]]
    return np.take_along_axis(both, order, axis=1), np.take_along_axis(every, order, axis=1)
