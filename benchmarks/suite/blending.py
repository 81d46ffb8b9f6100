"""A photo of frozen Gaussians as a sparse matrix: what methods that fit by rendering have in common."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Integer
from scipy.sparse import csr_array

from drsplat import View, ViewFeatures
from drsplat.kernels import SplatArrays, topk_contributions


class Blending(NamedTuple):
    """Of the pixels of a photo that a mask covers: weights, pixels x Gaussians, and which mask it is."""

    weights: csr_array
    masks: Integer[np.ndarray, " p"]


def blending_of(
    splats: SplatArrays, view: View, features: ViewFeatures, width: int, contributors: int, threads: int
) -> Blending:
    """width: pixels, of a photo that is wider. contributors: of a pixel, those of the largest weights."""
    small = view.resized(width, round(width * view.height / view.width)) if view.width > width else view
    masks = features.resized(small.width, small.height).mask_ids.ravel()
    found = topk_contributions(splats, small, contributors, threads=threads)
    ids, values = (array.reshape(-1, contributors) for array in found)
    covered = masks >= 0
    ids, values = ids[covered], values[covered]
    starts = np.append(0, np.cumsum((ids >= 0).sum(1)))
    shape = (len(ids), len(splats.opacities))
    return Blending(csr_array((values[ids >= 0], ids[ids >= 0], starts), shape=shape), masks[covered])
