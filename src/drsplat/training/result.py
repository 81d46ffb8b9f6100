"""The result of a training."""

from dataclasses import dataclass

from ..scene.gaussians import Gaussians
from .evaluation import Evaluation
from .settings import TrainingSettings

MAX_HELD_OUT_LOSS_DB = 10.0  # well covered captures lose 3 dB on held-out photos, sparse ones up to 8


@dataclass(frozen=True, eq=False)
class Training:
    """The result of a training.

    evaluation: on the held-out photos; None when there are none. psnr_train: mean over as many of the photos that
    it was trained on, in dB. seconds: of optimisation, over all sittings. stage_seconds: the same by stage.
    history: evaluations on the way. start: points that it started from, by where they came from. num_masked: photos,
    trained on or held out, of which masks leave pixels out: these take no part, in measures neither.
    """

    gaussians: Gaussians
    settings: TrainingSettings
    evaluation: Evaluation | None
    seconds: float
    stage_seconds: dict[str, float]
    history: list[dict[str, object]]
    psnr_train: float
    start: dict[str, int]
    num_masked: int = 0

    @property
    def held_out_far_below(self) -> bool:
        """True where held-out photos are rendered so much worse that the scene is fog from other viewpoints."""
        test = self.evaluation
        return test is not None and self.psnr_train - test.psnr > MAX_HELD_OUT_LOSS_DB

    def measures(self) -> dict[str, object]:
        """Return the main numbers, for JSON."""
        return {
            "psnr_test": self.evaluation.psnr if self.evaluation else None,
            "psnr_train": self.psnr_train,
            "held_out_far_below": self.held_out_far_below,
            "ssim_test": self.evaluation.ssim if self.evaluation else None,
            "num_gaussians": len(self.gaussians),
            "iterations": self.settings.iterations,
            "seconds": self.seconds,
            "num_test_views": len(self.evaluation.views) if self.evaluation else 0,
            "num_masked_views": self.num_masked,
            "stage_seconds": self.stage_seconds,
            "start": self.start,
        }
