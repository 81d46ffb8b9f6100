"""`train` with gsplat's rasterisation and strategies: posed photos in, Gaussians out."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import torch

from ..errors import DrSplatError
from .gsplat_run import DeviceRun, Engine
from .gsplat_strategy import require_what_gsplat_can
from .job import Job
from .keeper import Keeper
from .loop import optimise, trained
from .result import Training


def train(job: Job, engine: Engine) -> Training:
    """Train on the engine's device, see `loop.train`; on a GPU the bits differ from run to run.

    Start, photos, schedules and files are those of the CPU. Held-out photos are rendered by our own
    kernels on the CPU, so that the measures of all devices compare. torch's generators are seeded.

    Raises: as `loop.train`, and InputError: a setting that gsplat has fixed at another value.
    DrSplatError: the device's memory is full.
    """
    require_what_gsplat_can(job.settings)
    return trained(job, partial(DeviceRun, engine=engine), _optimise)


def _optimise(run: DeviceRun, keeper: Keeper, job: Job) -> None:
    with _full_precision(), _memory_explained(run):
        optimise(run, keeper, job)


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
            f"the GPU's memory is full at {len(run):,} Gaussians, in iteration {run.iteration}: limit them with "
            f"max_gaussians=N, or train on smaller photos. {error}"
        ) from error
