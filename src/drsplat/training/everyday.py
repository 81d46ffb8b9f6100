"""drsplat's own numbers: a schedule for a few minutes of a CPU, planned for its length.

Each was chosen by the PSNR of held-out photos and by time, see docs/training.md.
"""

from collections.abc import Sequence
from typing import Any

from ..scene.views import View
from .settings import TrainingSettings

ITERATIONS = 4000
UNREFINED = 1 / 8  # of the iterations, before Gaussians are added, and no more of them than originally
REFINED = 0.63  # of the iterations, until Gaussians are no longer added; as in the original schedule of mcmc, with it
REFINED_BY_CHANCE = 25 / 30
FULL_SIZE = 1 / 4  # of the iterations, from when on photos are as they are
DEGREES = 7  # of harmonics that would come in all the iterations
OPACITY_PENALTY = 0.01
RATES = {"means_rate_end": 1.6e-5, "sh_rest_rate": 5e-4, "scales_rate": 1e-2, "quats_rate": 4e-3}
"""Steps of Adam, in the units of TrainingSettings: there are few, so that longer ones reach as far."""
PIXELS_EACH = 1.9  # of a photo, for each Gaussian
PHOTOS = 100  # that a budget of one photo's pixels serves; more photos show more


def everyday(views: Sequence[View], iterations: int = ITERATIONS, **chosen: Any) -> TrainingSettings:
    """Return settings for so many iterations: rates, degrees and refinement have come to their end at the last one.

    Steps are fewer than originally, and longer (`RATES`). No opacity is reset. A penalty on opacities removes what no
    photo needs instead; photos are small at first; and the number of Gaussians follows the pixels of the photos
    (`budget_of`).
    views: to train on, at the size to train at. chosen: any other field of TrainingSettings, which counts.

    Raises: InputError: as TrainingSettings.
    """
    refined = REFINED_BY_CHANCE if chosen.get("strategy") == "mcmc" else REFINED
    numbers = RATES | {
        "iterations": iterations,
        "means_rate_steps": iterations,
        "sh_degree_every": max(iterations // DEGREES, 1),
        "full_size_from": round(FULL_SIZE * iterations),
        "refine_from": min(round(UNREFINED * iterations), TrainingSettings.refine_from),
        "refine_until": round(refined * iterations),
        "reset_every": iterations,
        "reset_recovery": iterations,
        "opacity_penalty": OPACITY_PENALTY,
        "max_gaussians": budget_of(views),
    }
    return TrainingSettings(**(numbers | {name: value for name, value in chosen.items() if value is not None}))


def budget_of(views: Sequence[View]) -> int:
    """Return the most Gaussians that photos of this size and number are given."""
    pixels = sum(view.width * view.height for view in views)
    return max(round(pixels / PIXELS_EACH / min(max(len(views), 1), PHOTOS)), 4)
