"""`train` on a CUDA GPU, by our own kernels; optional extra `[cuda]`."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from ..kernels.cuda.engine import Engine, cuda_engine, memory_explained
from .device_run import CURE, DeviceRun
from .job import Job
from .keeper import Keeper
from .loop import optimise, trained
from .result import Training


def train(job: Job, engine: Engine | None = None) -> Training:
    """Train on the device, see `loop.train`: start, photos, schedules, density control and files are those of the CPU.

    Held-out photos are rendered by the CPU's kernels, so that the measures of all devices compare.

    Raises: as `loop.train`, and MissingExtraError: no GPU, or no CuPy. DrSplatError: the device's memory is full.
    """
    return trained(job, partial(DeviceRun, engine=engine or cuda_engine()), _optimise)


def _optimise(run: DeviceRun, keeper: Keeper, job: Job) -> None:
    with _memory_explained(run):
        optimise(run, keeper, job)


@contextmanager
def _memory_explained(run: DeviceRun) -> Iterator[None]:
    with memory_explained(lambda: f"at {len(run):,} Gaussians, in iteration {run.iteration}: {CURE}"):
        yield
