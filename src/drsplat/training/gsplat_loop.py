"""`train` with gsplat's rasterisation and strategies: posed photos in, Gaussians out."""

import math
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from ..errors import DrSplatError, InputError
from ..formats.captures import SparsePoints
from ..views import View
from .gsplat_run import DeviceRun, Drawn, Engine
from .gsplat_strategy import require_what_gsplat_can
from .interrupting import deferred_interrupt
from .keeper import Keeper, beginning
from .loop import CHECKPOINT_EVERY, PSNR_EVERY, PSNR_MEMORY, Status
from .model_folder import model_folder
from .optimizer import Optimizer
from .result import Training
from .settings import TrainingSettings
from .start import first_gaussians, local_capture, scene_extent, split_views


def train(
    views: Sequence[View],
    settings: TrainingSettings | None = None,
    output_dir: str | Path | None = None,
    *,
    engine: Engine,
    points: SparsePoints | None = None,
    overwrite: bool = False,
    save_at: Collection[int] = (7000,),
    checkpoint_every: int = CHECKPOINT_EVERY,
    threads: int = 0,
    report: Callable[[Status], None] | None = None,
) -> Training:
    """As `loop.train`, on the engine's device; on a GPU not the same to the bit each time.

    Start, photos, schedules and files are those of the CPU. Held-out photos are rendered by our own
    kernels on the CPU, so that the measures of all devices compare. torch's generators are seeded.

    Raises: as `loop.train`, and InputError: a setting that gsplat has fixed at another value.
    DrSplatError: the device's memory is full.
    """
    settings = settings or TrainingSettings()
    if checkpoint_every < 1:
        raise InputError(f"checkpoint_every: expected at least 1, got {checkpoint_every}")
    require_what_gsplat_can(settings)
    split, points, origin = local_capture(split_views(views, settings.test_every), points)
    extent, rng = scene_extent(split.train), np.random.default_rng(settings.seed)
    with model_folder(output_dir, overwrite) as folder:
        start = beginning(folder, points, split.train, settings, rng, origin)
        optimizer = Optimizer(first_gaussians(start.points, settings))
        run = DeviceRun(split.train, settings, extent, optimizer, rng, origin, engine=engine)
        keeper = Keeper(run, split, folder, save_at, checkpoint_every, threads)
        keeper.begin(points, start)
        with _full_precision(), _memory_explained(run), deferred_interrupt() as interrupted:
            _optimise(run, keeper, report, interrupted)
        return keeper.finish()


def _optimise(
    run: DeviceRun,
    keeper: Keeper,
    report: Callable[[Status], None] | None,
    interrupted: Callable[[], bool],
) -> None:
    psnr = math.nan
    while run.iteration < run.settings.iterations:
        begin = time.perf_counter()
        drawn = run.advance()
        run.seconds += time.perf_counter() - begin
        keeper.after_step(interrupted())
        if report is None:
            continue
        if run.iteration % PSNR_EVERY == 0:
            now = _psnr(drawn)
            psnr = now if math.isnan(psnr) else PSNR_MEMORY * psnr + (1 - PSNR_MEMORY) * now
        count = len(run.scene)
        report(Status(run.iteration, run.settings.iterations, drawn.loss, psnr, count))


def _psnr(drawn: Drawn) -> float:
    error = float(((drawn.image.clamp(0, 1) - drawn.target) ** 2).mean())
    return min(-10 * math.log10(max(error, 1e-30)), 99.0)


@contextmanager
def _full_precision() -> Iterator[None]:
    """Convolutions in float32: SSIM's variances are small differences, of which TF32 leaves little."""
    before = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = before


@contextmanager
def _memory_explained(run: DeviceRun) -> Iterator[None]:
    try:
        yield
    except torch.cuda.OutOfMemoryError as error:
        raise DrSplatError(
            f"the GPU's memory is full at {len(run.scene):,} Gaussians, in iteration {run.iteration}: "
            "limit them with max_gaussians=N, or train on smaller photos. "
            f"{error}"
        ) from error
