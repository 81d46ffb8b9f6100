"""The twin of `kernels.scan.keep_best`: every score of a row is sorted anew."""

import numpy as np

from drsplat.base.arrays import Float, Integer


def keep_best(
    scores: Float[np.ndarray, "t r"], names: Integer[np.ndarray, "t r"], found: Float[np.ndarray, "c r"], first: int
) -> tuple[Float[np.ndarray, "t r"], Integer[np.ndarray, "t r"]]:
    """Return the best of both, highest first, and their names; of equal ones the earlier."""
    new = np.broadcast_to(np.arange(first, first + len(found))[:, None], found.shape)
    both, every = np.concatenate([scores, found]), np.concatenate([names, new])
    order = np.argsort(-both, axis=0, kind="stable")[: len(scores)]
    return np.take_along_axis(both, order, axis=0), np.take_along_axis(every, order, axis=0)
