"""`train` on the device that is asked for: on the CPU, or on a CUDA GPU."""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from ..formats.captures import SparsePoints
from ..kernels.cuda.devices import chosen_device
from ..scene.views import View
from . import device_run, loop
from .everyday import everyday
from .job import CHECKPOINT_EVERY, SAVE_AT, Job, Status
from .result import Training
from .settings import TrainingSettings


def train(
    views: Sequence[View],
    settings: TrainingSettings | None = None,
    output_dir: str | Path | None = None,
    *,
    points: SparsePoints | None = None,
    device: str = "auto",
    overwrite: bool = False,
    save_at: Collection[int] = SAVE_AT,
    checkpoint_every: int = CHECKPOINT_EVERY,
    threads: int = 0,
    report: Callable[[Status], None] | None = None,
) -> Training:
    """Optimise a scene of Gaussians until it looks like the photos.

    views: posed photos, at the size to train at (`read_views(max_side=...)`, `View.resized`).
    settings: None takes `everyday(views)`, a few minutes of a CPU; `TrainingSettings()` are those of the original.
    output_dir: written as `training.model_folder` says. A run of the same settings, views, photos and
    points that is in it goes on by itself, on the CPU to the bit as if it had never stopped; so does a finished one of
    the original's settings when more iterations are asked for. None keeps everything in memory.
    points: where to start (`read_sparse_points`); None triangulates some from the photos.
    device: "cpu", "cuda", or "auto": CUDA where CuPy and a GPU are at hand, else the CPU.
    save_at: iterations after which the scene is written as well, before an opacity reset that is due
    then. checkpoint_every: iterations, and at
    the latest every two minutes. report: called after every iteration.

    On the CPU the result is the same to the bit for any number of threads. Ctrl-C ends it between two
    iterations with a KeyboardInterrupt that says how to go on.

    Warns: DrSplatWarning: few points could be triangulated, poses that do not fit the photos, held-out
    photos far below those trained on.

    Raises: InputError: views without photos, fewer than two to train on, all cameras in one place, points that are not
    finite or too few, a folder that holds something else or that another process trains in, a full disk. MismatchError:
    the folder holds a run of other settings or inputs. FormatError: a damaged photo. MissingExtraError: device "cuda"
    without CuPy or a GPU. DrSplatError: the optimisation diverged.
    Source: 3DGS; "3D Gaussian Splatting as Markov Chain Monte Carlo".
    """
    job = Job(
        views, settings or everyday(views), output_dir, points, overwrite, save_at, checkpoint_every, threads, report
    )
    return (loop if chosen_device(device) == "cpu" else device_run).train(job)
