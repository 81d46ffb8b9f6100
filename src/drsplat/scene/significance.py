"""Significance: which Gaussians a picture lacks most where there is no room for all."""

import numpy as np

from ..base.arrays import Float64, Int64
from .gaussians import Gaussians

VOLUME_POWER = 0.1


def significance(gaussians: Gaussians) -> Float64[np.ndarray, " n"]:
    """Return the opacity of each Gaussian times its volume to the power 0.1: how much a picture lacks without it.

    Source: Fan et al. 2023 (LightGaussian) Eq. 2, without its count of rays: it needs no photos.
    """
    return np.asarray(gaussians.opacities * gaussians.scales.astype(np.float64).prod(1) ** VOLUME_POWER)


def most_significant(gaussians: Gaussians, budget: int) -> Int64[np.ndarray, " m"]:
    """Return the ascending ids of the `budget` Gaussians of the largest `significance`."""
    if len(gaussians) <= budget:
        return np.arange(len(gaussians))
    return np.sort(np.argpartition(-significance(gaussians), budget - 1)[:budget])
