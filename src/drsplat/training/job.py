"""A training's job, its status while it is under way, and the beginning of its optimisation."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Float64
from ..errors import InputError
from ..formats.captures import SparsePoints
from ..scene.gaussians import Gaussians
from ..scene.views import View
from .evaluation import Evaluation
from .optimizer import Optimizer
from .settings import TrainingSettings

CHECKPOINT_EVERY = 1000
SAVE_AT = (7000,)
MAX_HELD_OUT_LOSS_DB = 10.0  # well covered captures lose 3 dB on held-out photos, sparse ones up to 8


class Status(NamedTuple):
    """Status of a run under way. psnr: running mean over the photos it is trained on, in dB."""

    iteration: int
    iterations: int
    loss: float
    psnr: float
    num_gaussians: int


@dataclass(frozen=True, eq=False)
class Job:
    """The arguments of `devices.train`, which describes them, but for the device.

    Raises: InputError: checkpoint_every < 1.
    """

    views: Sequence[View]
    settings: TrainingSettings = field(default_factory=TrainingSettings)
    output_dir: str | Path | None = None
    points: SparsePoints | None = None
    overwrite: bool = False
    save_at: Collection[int] = SAVE_AT
    checkpoint_every: int = CHECKPOINT_EVERY
    threads: int = 0
    report: Callable[[Status], None] | None = None

    def __post_init__(self) -> None:
        if self.checkpoint_every < 1:
            raise InputError(f"checkpoint_every: expected at least 1, got {self.checkpoint_every}")


@dataclass(frozen=True, eq=False)
class Beginning:
    """Inputs of a run. origin: the point of the world that is zero in the frame of views and Gaussians."""

    views: Sequence[View]
    settings: TrainingSettings
    optimizer: Optimizer
    rng: np.random.Generator
    origin: Float64[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))


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
