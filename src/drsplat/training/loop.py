"""`train`: posed photos in, Gaussians out."""

import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..formats.captures import SparsePoints
from ..views import View
from .interrupting import deferred_interrupt
from .keeper import Keeper, beginning
from .metrics import psnr
from .model_folder import model_folder
from .optimizer import Optimizer
from .result import Training
from .run import Outcome, Run
from .settings import TrainingSettings
from .start import first_gaussians, local_capture, scene_extent, split_views

CHECKPOINT_EVERY = 1000
PSNR_EVERY, PSNR_MEMORY = 10, 0.95


class Status(NamedTuple):
    """Of a run under way. psnr: running mean over the photos it is trained on, in dB."""

    iteration: int
    iterations: int
    loss: float
    psnr: float
    num_gaussians: int


def train(
    views: Sequence[View],
    settings: TrainingSettings | None = None,
    output_dir: str | Path | None = None,
    *,
    points: SparsePoints | None = None,
    overwrite: bool = False,
    save_at: Collection[int] = (7000,),
    checkpoint_every: int = CHECKPOINT_EVERY,
    threads: int = 0,
    report: Callable[[Status], None] | None = None,
) -> Training:
    """`devices.train` on the CPU, natively; the same bits for any number of threads.

    Raises: as `devices.train`.
    Source: 3DGS; 3DGS as MCMC.
    """
    settings = settings or TrainingSettings()
    if checkpoint_every < 1:
        raise InputError(f"checkpoint_every: expected at least 1, got {checkpoint_every}")
    split, points, origin = local_capture(split_views(views, settings.test_every), points)
    extent, rng = scene_extent(split.train), np.random.default_rng(settings.seed)
    with model_folder(output_dir, overwrite) as folder:
        start = beginning(folder, points, split.train, settings, rng, origin)
        optimizer = Optimizer(first_gaussians(start.points, settings))
        run = Run(split.train, settings, extent, optimizer, rng, origin)
        keeper = Keeper(run, split, folder, save_at, checkpoint_every, threads)
        keeper.begin(points, start)
        _optimise(run, keeper, threads, report)
        return keeper.finish()


def _optimise(
    run: Run, keeper: Keeper, threads: int, report: Callable[[Status], None] | None
) -> None:
    meter = _Meter()
    with deferred_interrupt() as interrupted:
        while run.iteration < run.settings.iterations:
            begin = time.perf_counter()
            outcome = run.step(threads)
            run.seconds += time.perf_counter() - begin
            keeper.after_step(interrupted())
            if report is not None:
                report(meter.status(run, outcome))


class _Meter:
    """Running PSNR of the photos trained on; for the eye, so it is not part of the state."""

    def __init__(self) -> None:
        self.psnr = float("nan")

    def status(self, run: Run, outcome: Outcome) -> Status:
        if run.iteration % PSNR_EVERY == 0:
            now = min(psnr(np.clip(outcome.image, 0, 1), outcome.target), 99.0)
            known = self.psnr == self.psnr
            self.psnr = PSNR_MEMORY * self.psnr + (1 - PSNR_MEMORY) * now if known else now
        count = len(run.optimizer)
        return Status(run.iteration, run.settings.iterations, outcome.loss.value, self.psnr, count)
