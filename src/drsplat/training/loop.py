"""`train`: posed photos in, Gaussians out."""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..formats.captures import SparsePoints
from ..gaussians import Gaussians
from ..views import View
from .checkpoint import capture_fingerprint, load_checkpoint, save_checkpoint
from .evaluation import Evaluation, evaluate
from .metrics import psnr
from .model_folder import ModelFolder
from .optimizer import Optimizer
from .run import Outcome, Run
from .settings import TrainingSettings
from .start import first_gaussians, local_capture, scene_extent, split_views, start_points
from .training_photos import TrainingPhotos

CHECKPOINT_EVERY, CHECKPOINT_SECONDS = 1000, 120.0
PSNR_EVERY, PSNR_MEMORY = 10, 0.95


class Status(NamedTuple):
    """Of a run under way. psnr: running mean over the photos it is trained on, in dB."""

    iteration: int
    iterations: int
    loss: float
    psnr: float
    num_gaussians: int


@dataclass(frozen=True, eq=False)
class Training:
    """What a run has made.

    evaluation: of the held-out photos; None when there are none. seconds: of optimisation, over all
    sittings. stage_seconds: the same by stage. history: evaluations on the way.
    """

    gaussians: Gaussians
    settings: TrainingSettings
    evaluation: Evaluation | None
    seconds: float
    stage_seconds: dict[str, float]
    history: list[dict[str, object]]

    def measures(self) -> dict[str, object]:
        """The headline, for JSON."""
        return {
            "psnr_test": self.evaluation.psnr if self.evaluation else None,
            "ssim_test": self.evaluation.ssim if self.evaluation else None,
            "num_gaussians": len(self.gaussians),
            "iterations": self.settings.iterations,
            "seconds": self.seconds,
            "num_test_views": len(self.evaluation.views) if self.evaluation else 0,
            "stage_seconds": self.stage_seconds,
        }


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
    rng = np.random.default_rng(settings.seed)
    start = start_points(points, split.train, settings, rng)
    extent = scene_extent(split.train)
    optimizer = Optimizer(first_gaussians(start, settings))
    run = Run(split.train, settings, extent, optimizer, rng, origin)
    keeper = _Keeper(run, split.test, output_dir, save_at, checkpoint_every, threads)
    capture = capture_fingerprint([*split.train, *split.test], points)
    keeper.begin(
        capture, overwrite, lambda folder: folder.write_start(views, start.moved(origin), settings)
    )
    _optimise(run, keeper, threads, report)
    return keeper.finish()


def _optimise(
    run: Run, keeper: "_Keeper", threads: int, report: Callable[[Status], None] | None
) -> None:
    meter = _Meter()
    while run.iteration < run.settings.iterations:
        begin = time.perf_counter()
        outcome = run.step(threads)
        run.seconds += time.perf_counter() - begin
        keeper.after_step()
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


class _Keeper:
    """Everything about a run that is not a step: its files and its measures."""

    def __init__(
        self,
        run: Run,
        test: list[View],
        output_dir: str | Path | None,
        save_at: Collection[int],
        checkpoint_every: int,
        threads: int,
    ) -> None:
        self.run, self.test, self.threads = run, test, threads
        self.folder = None if output_dir is None else ModelFolder(output_dir)
        self.save_at, self.checkpoint_every = save_at, checkpoint_every
        self.test_photos = TrainingPhotos(test, run.settings.photo_memory_bytes)
        self.capture = ""
        self.saved = time.monotonic()

    def begin(
        self, capture: str, overwrite: bool, write_start: Callable[[ModelFolder], None]
    ) -> None:
        """Go on with what is in the folder, or make it ready."""
        self.capture = capture
        if self.folder is None:
            return
        if self.folder.prepare(overwrite):
            load_checkpoint(self.folder.checkpoint, self.run, capture)
        else:
            write_start(self.folder)

    def after_step(self) -> None:
        run = self.run
        if run.iteration == run.settings.iterations:
            return
        every = run.settings.evaluate_every
        if every and run.iteration % every == 0:
            self._note()
        if self.folder is None:
            return
        if run.iteration in self.save_at:
            self.folder.write_scene(run.iteration, run.gaussians())
        late = time.monotonic() - self.saved > CHECKPOINT_SECONDS
        if late or run.iteration % self.checkpoint_every == 0:
            save_checkpoint(self.folder.checkpoint, run, self.capture)
            self.saved = time.monotonic()

    def _note(self) -> None:
        scores = self._evaluate(None)
        if scores is not None:
            entry: dict[str, object] = {
                "iteration": self.run.iteration,
                "psnr_test": scores.psnr,
                "ssim_test": scores.ssim,
                "num_gaussians": len(self.run.optimizer),
                "seconds": self.run.seconds,
            }
            self.run.history.append(entry)

    def _evaluate(self, pictures: Path | None) -> Evaluation | None:
        run = self.run
        return evaluate(
            run.optimizer.parameters, self.test, self.test_photos, run.settings,
            near=run.near, pictures=pictures, threads=self.threads,
        )  # fmt: skip

    def finish(self) -> Training:
        """Measure, write the scene and the results; the checkpoint goes last."""
        run, folder = self.run, self.folder
        gaussians = run.gaussians()
        if folder is not None:
            folder.write_scene(run.settings.iterations, gaussians)
        evaluation = self._evaluate(folder.test_pictures if folder else None)
        training = Training(
            gaussians, run.settings, evaluation, run.seconds, run.stage_seconds, run.history
        )
        if folder is not None:
            details = {"history": run.history, "test": evaluation.plain() if evaluation else None}
            folder.write_json("results.json", training.measures() | details)
            folder.checkpoint.unlink(missing_ok=True)
        return training
