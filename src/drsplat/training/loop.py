"""`train`: posed photos in, Gaussians out."""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ..formats.captures import SparsePoints
from ..formats.ply import read_point_ply
from .keeper import Keeper
from .model_folder import model_folder
from .optimizer import Optimizer
from .run import Beginning, Job, R, Run, Status, Training
from .start import first_gaussians, local_capture, split_views
from .start_points import Start, start_points

PSNR_EVERY, PSNR_MEMORY = 10, 0.95


def train(job: Job) -> Training:
    """Train as `devices.train` does, on the CPU, natively; the same bits for any number of threads.

    Raises: as `devices.train`.
    Source: 3DGS; 3DGS as MCMC.
    """
    return trained(job, Run, lambda _: nullcontext())


def trained(
    job: Job, run_of: Callable[[Beginning], R], guarded: Callable[[R], AbstractContextManager[None]]
) -> Training:
    """Run a job from its photos to its results, on any device. guarded: context of the optimisation."""
    settings = job.settings
    split, points, origin = local_capture(split_views(job.views, settings.test_every), job.points)
    rng = np.random.default_rng(settings.seed)
    with model_folder(job.output_dir, job.overwrite) as folder, TemporaryDirectory(prefix="drsplat-") as place:
        if folder is not None and folder.goes_on and folder.start.is_file():  # in the world's coordinates
            start = Start(SparsePoints(*read_point_ply(folder.start)).moved(-origin))
        else:
            start = start_points(points, split.train, settings, rng, threads=job.threads)
        optimizer = Optimizer(first_gaussians(start.points, settings))
        run = run_of(Beginning(split.train, settings, optimizer, rng, origin))
        keeper = Keeper(run, split, folder, job, Path(place))
        keeper.begin(points, start)
        with guarded(run):
            optimise(run, keeper, job)
        return keeper.finish()


def optimise(run: Run, keeper: Keeper, job: Job) -> None:
    """Step by step to the end. The PSNR of photos trained on is for the eye, and not part of the state."""
    psnr = math.nan
    with deferred_interrupt() as interrupted:
        while run.iteration < run.settings.iterations:
            if run.iteration and run.iteration == run.settings.transients_at:
                keeper.leave_transients_out()
            begin = time.perf_counter()
            outcome = run.step(job.threads)
            run.seconds += time.perf_counter() - begin
            keeper.after_step(interrupted())
            if job.report is None:
                continue
            if run.iteration % PSNR_EVERY == 0:
                now = outcome.psnr()
                psnr = now if math.isnan(psnr) else PSNR_MEMORY * psnr + (1 - PSNR_MEMORY) * now
            iterations = run.settings.iterations
            job.report(Status(run.iteration, iterations, outcome.loss, psnr, len(run)))


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Yield whether Ctrl-C was pressed since the block began; pressed again, it interrupts at once.

    Where Python's own handler is not in force, as in a thread or in a program that has another one, nothing changes.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: False
        return
    pressed = threading.Event()

    def note(*_: object) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        pressed.set()

    signal.signal(signal.SIGINT, note)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
