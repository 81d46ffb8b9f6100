"""A training's job, its status while it is under way, and the beginning of its optimisation."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Float64
from ..errors import InputError
from ..formats.captures import SparsePoints
from ..scene.views import View
from .optimizer import Optimizer
from .settings import TrainingSettings

CHECKPOINT_EVERY = 1000
SAVE_AT = (7000,)


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
