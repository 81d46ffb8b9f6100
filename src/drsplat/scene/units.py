"""Whether a scene and its cameras can be of one frame and of a sensible unit."""

from collections.abc import Sequence

import numpy as np

from .gaussians import Gaussians
from .placing import FEWEST, middle_of, rounding, size_of
from .views import View

SMALLEST, LARGEST = 1e-3, 1e5  # scene units
LOST_SHARE = 1e-5  # of the scene's size: positions that are rounded by more are warned of
AWAY = 100.0  # sizes of the scene
ENOUGH = 1 << 16  # Gaussians, spread over the file, that tell where the scene is


def lost_precision(gaussians: Gaussians) -> list[str]:
    """Return a sentence on what float32 positions far from zero have lost, if that is much."""
    much = LOST_SHARE * size_of(gaussians.means)
    if len(gaussians) < FEWEST or not rounding(gaussians.means) > much > 0:
        return []  # not even the farthest have, and the middle is nearer
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
    """What makes no sense about the lengths of a scene and the places of its cameras, a sentence each."""
    means = gaussians.means[:: max(1, len(gaussians) // ENOUGH)]
    size = size_of(means)
    if len(gaussians) < FEWEST or not size > 0:
        return []
    found = lost_precision(gaussians)
    if not SMALLEST <= size <= LARGEST:
        found.append(
            f"the scene is {size:.3g} units large: is its unit meant? Expected was between {SMALLEST:g} and {LARGEST:g}"
        )
    middle = gaussians.origin + middle_of(means)
    away = float(np.median([np.linalg.norm(view.center - middle) for view in views])) if views else 0
    if away > AWAY * size:
        found.append(
            f"half of the {len(views)} cameras are {away:.3g} units or more from the middle of the Gaussians, which "
            f"are {size:.3g} units large: scene and cameras are hardly of one frame and scale (scenes that nerfstudio "
            "trained need dataparser_transforms=FILE)"
        )
    return found
