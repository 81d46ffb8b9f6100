"""Everything about a run that is not a step: its files, how it goes on, and its measures."""

import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..base.arrays import Float64
from ..errors import DrSplatWarning, InputError
from ..formats.captures import SparsePoints
from ..formats.ply import read_point_ply
from ..scene.views import View
from .checkpoint import capture_fingerprint, load_checkpoint, save_checkpoint
from .evaluation import Evaluation, evaluate
from .job import Job
from .model_folder import ModelFolder
from .result import Training
from .run import Run
from .settings import TrainingSettings
from .start import Split
from .start_points import Start, start_points
from .training_photos import TrainingPhotos

CHECKPOINT_S = 120.0
MAX_SCORED_TRAIN_PHOTOS = 16


def start_of(
    folder: ModelFolder | None,
    points: SparsePoints | None,
    views: Sequence[View],
    settings: TrainingSettings,
    rng: np.random.Generator,
    origin: Float64[np.ndarray, " 3"],
    *,
    threads: int = 0,
) -> Start:
    """Return `start_points`, or what the run in the folder started from, which need not be found again.

    origin: of the frame of `points`, `views` and the answer, in the world, whose coordinates the folder has.

    Raises: as `start_points`.
    """
    if folder is not None and folder.goes_on and folder.start.is_file():
        return Start(SparsePoints(*read_point_ply(folder.start)).moved(-origin))
    return start_points(points, views, settings, rng, threads=threads)


class Keeper:
    """One sitting of a run, with its folder or without one."""

    def __init__(self, run: Run, split: Split, folder: ModelFolder | None, job: Job) -> None:
        self.run, self.split, self.folder, self.job = run, split, folder, job
        self.test_photos = TrainingPhotos(split.test, run.settings.photo_memory_bytes)
        self.capture = ""
        self.saved = time.monotonic()

    def begin(self, points: SparsePoints | None, start: Start) -> None:
        """Go on with what is in the folder, or write what a run begins with."""
        run, folder = self.run, self.folder
        run.start = start.plain()
        if folder is None:
            return
        views = sorted([*self.split.train, *self.split.test], key=lambda view: view.name)
        self.capture = capture_fingerprint(views, points)
        views = [view.relative_to(-run.origin) for view in views]
        if folder.goes_on:
            load_checkpoint(folder.checkpoint, run, self.capture)
            folder.results.unlink(missing_ok=True)  # until there are those of this length
            folder.write_settings(views, run.settings)
        else:
            folder.write_start(views, start.points.moved(run.origin))
            folder.write_settings(views, run.settings)
            self._checkpoint()  # whatever is written from here on can be gone on with

    def after_step(self, interrupted: bool) -> None:
        """Evaluate and save where it is time. Raises: KeyboardInterrupt: `interrupted`; all is in the checkpoint."""
        run, settings = self.run, self.run.settings
        if run.iteration == settings.iterations:
            return
        if settings.evaluate_every and run.iteration % settings.evaluate_every == 0:
            self._note()
        if self.folder is not None:
            self._keep(self.folder, interrupted)
        if interrupted:
            raise KeyboardInterrupt(self._how_to_go_on())

    def _keep(self, folder: ModelFolder, interrupted: bool) -> None:
        run = self.run
        if run.iteration in self.job.save_at:
            folder.write_scene(run.iteration, run.gaussians())
        late = time.monotonic() - self.saved > CHECKPOINT_S
        # from the last but one, a longer run goes on as if it had been planned so
        last = run.iteration == run.settings.iterations - 1
        if late or last or interrupted or run.iteration % self.job.checkpoint_every == 0:
            self._checkpoint()

    def _checkpoint(self) -> None:
        if self.folder is None:
            raise InputError("a run without a folder keeps no checkpoint")
        save_checkpoint(self.folder.checkpoint, self.run, self.capture)
        self.saved = time.monotonic()

    def _how_to_go_on(self) -> str:
        at = f"after iteration {self.run.iteration:,} of {self.run.settings.iterations:,}"
        if self.folder is None:
            return at
        return (
            f"{at}, which {self.folder.checkpoint} holds: the same command, without overwrite=True, goes on from there"
        )

    def _note(self) -> None:
        scores = self._tested(None)
        if scores is not None:
            entry: dict[str, object] = {
                "iteration": self.run.iteration,
                "psnr_test": scores.psnr,
                "ssim_test": scores.ssim,
                "num_gaussians": len(self.run.optimizer),
                "seconds": self.run.seconds,
            }
            self.run.history.append(entry)

    def _tested(self, pictures: Path | None) -> Evaluation | None:
        run = self.run
        return evaluate(
            run.optimizer.on_host(), self.split.test, self.test_photos, run.settings,
            near=run.near, pictures=pictures, threads=self.job.threads,
        )  # fmt: skip

    def _psnr_train(self, count: int) -> float:
        """Return the PSNR on `count` evenly spaced training photos."""
        views = self.split.train
        chosen = np.linspace(0, len(views) - 1, min(count, len(views))).round().astype(int)
        some = [views[index] for index in chosen]
        photos = TrainingPhotos(some, 0)
        run = self.run
        scores = evaluate(run.optimizer.on_host(), some, photos, run.settings, near=run.near, threads=self.job.threads)
        return scores.psnr if scores else float("nan")

    def finish(self) -> Training:
        """Measure, write the scene and, last, the results. The checkpoint stays, for a longer run."""
        run, folder = self.run, self.folder
        gaussians = run.gaussians()
        if folder is not None:
            folder.write_scene(run.settings.iterations, gaussians)
        evaluation = self._tested(folder.test_pictures if folder else None)
        train = self._psnr_train(min(max(len(self.split.test), 1), MAX_SCORED_TRAIN_PHOTOS))
        training = Training(
            gaussians, run.settings, evaluation, run.seconds, run.stage_seconds, run.history, train, run.start,
            sum(view.mask_path is not None for view in [*self.split.train, *self.split.test]),
        )  # fmt: skip
        _warn_of_fog(training)
        if folder is not None:
            details = {"history": run.history, "test": evaluation.plain() if evaluation else None}
            folder.write_json("results.json", training.measures() | details)
        return training


def _warn_of_fog(training: Training) -> None:
    test = training.evaluation
    if test is None or not training.held_out_far_below:
        return
    warnings.warn(
        f"held-out photos are rendered at {test.psnr:.1f} dB, those trained on at {training.psnr_train:.1f}: the scene "
        "looks right only from where it was photographed, as fog does, and searching it will disappoint. More photos "
        "from places in between help, as do sharper ones, right poses, and points to start from (points=FILE)",
        DrSplatWarning,
        stacklevel=4,
    )
