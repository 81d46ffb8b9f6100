"""Checks that a scene and its cameras can share a frame and have a sensible unit."""

from collections.abc import Sequence

import numpy as np

from .gaussians import MIN_SIZED_GAUSSIANS, Gaussians, middle_of, rounding, size_of
from .views import View

MIN_SIZE = 1e-3  # scene units
MAX_SIZE = 1e5
MAX_ROUNDING_SHARE = 1e-5  # of the scene's size: coarser rounding of positions gets a warning
MAX_CAMERA_DISTANCE_IN_SIZES = 100.0
MAX_SAMPLE_GAUSSIANS = 1 << 16  # spread over the file, to tell where the scene is


def lost_precision(gaussians: Gaussians) -> list[str]:
    """Return a sentence on the precision that float32 positions far from zero have lost, if it is much."""
    much = MAX_ROUNDING_SHARE * size_of(gaussians.means)
    if len(gaussians) < MIN_SIZED_GAUSSIANS or not rounding(gaussians.means) > much > 0:
        return []  # the farthest have lost little, and the middle less
    middle = middle_of(gaussians.means)
    away, lost, typical = np.abs(middle).max(), rounding(middle), float(np.median(gaussians.scales))
    if not lost > much:
        return []
    return [
        f"the scene lies {away:.3g} units from zero and its positions are float32, which "
        f"rounds them there to {lost:.2g} units; half of its Gaussians are smaller than {typical:.2g}. Keep x, y and z "
        "as double, or move scene and cameras towards zero before they are written"
    ]


def doubts(gaussians: Gaussians, views: Sequence[View]) -> list[str]:
    """Return sentences on implausible sizes of the scene or places of its cameras."""
    means = gaussians.means[:: max(1, len(gaussians) // MAX_SAMPLE_GAUSSIANS)]
    size = size_of(means)
    if len(gaussians) < MIN_SIZED_GAUSSIANS or not size > 0:
        return []
    sentences = lost_precision(gaussians)
    if not MIN_SIZE <= size <= MAX_SIZE:
        sentences.append(
            f"the scene is {size:.3g} units large: is its unit meant? "
            f"Expected was between {MIN_SIZE:g} and {MAX_SIZE:g}"
        )
    middle = gaussians.origin + middle_of(means)
    away = float(np.median([np.linalg.norm(view.center - middle) for view in views])) if views else 0
    if away > MAX_CAMERA_DISTANCE_IN_SIZES * size:
        sentences.append(
            f"half of the {len(views)} cameras are {away:.3g} units or more from the middle of the Gaussians, which "
            f"are {size:.3g} units large: scene and cameras are hardly of one frame and scale (scenes that nerfstudio "
            "trained need dataparser_transforms=FILE)"
        )
    return sentences
