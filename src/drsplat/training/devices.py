"""`train` on the device that is asked for: on the CPU, or on a CUDA GPU; and everyday settings for it.

These are drsplat's own numbers: a schedule for a few minutes of a CPU, planned for its length. Each was chosen by the
PSNR of held-out photos and by time, see docs/training.md.
"""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from ..formats.captures import SparsePoints
from ..kernels.cuda.devices import chosen_device
from ..scene.views import View
from . import device_run, loop
from .run import CHECKPOINT_EVERY, SAVE_AT, Job, Status, Training
from .settings import TrainingSettings

DEFAULT_ITERATIONS = 3000
REFINE_FROM_SHARE = 1 / 8  # of the iterations; and no later than originally
REFINE_UNTIL_SHARE = 0.63  # of the iterations
MCMC_REFINE_UNTIL_SHARE = 25 / 30  # as in the original schedule of mcmc
FULL_SIZE_FROM_SHARE = 0.7  # of the iterations; photos are coarser before
TRANSIENTS_SHARE = 1 / 2  # of the iterations, after which what moves is looked for
RATES_FALL_FROM_SHARE = 0.8  # of the iterations, after which the noise of single photos is averaged out
SH_DEGREES = 7  # of harmonics that all the iterations would have time for
OPACITY_PENALTY = 0.03  # with more, fewer Gaussians are left; with less, few photos are learnt by heart
RATES = {"means_rate_end": 1.6e-5, "sh_rest_rate": 5e-4, "scales_rate": 1e-2, "quats_rate": 4e-3}
"""Steps of Adam, in the units of TrainingSettings: there are few, so that longer ones reach as far."""
PIXELS_PER_GAUSSIAN = 1.9  # of a photo
MAX_BUDGET_PHOTOS = 100  # that a budget of one photo's pixels serves; more photos show more


def everyday(views: Sequence[View], iterations: int = DEFAULT_ITERATIONS, **chosen: Any) -> TrainingSettings:
    """Return settings for so many iterations: rates, degrees and refinement have come to their end at the last one.

    Steps are fewer than originally, and longer (`RATES`). No opacity is reset. A penalty on opacities removes what no
    photo needs instead; photos are small at first; what moves between them is left out half-way; and the number of
    Gaussians follows the pixels of the photos (`budget_of`).
    views: to train on, at the size to train at. chosen: any other field of TrainingSettings, which counts.

    Raises: InputError: as TrainingSettings.
    """
    is_mcmc = chosen.get("strategy") == "mcmc"
    refined = MCMC_REFINE_UNTIL_SHARE if is_mcmc else REFINE_UNTIL_SHARE
    numbers = RATES | {
        "iterations": iterations,
        "means_rate_steps": iterations,
        "sh_degree_every": max(iterations // SH_DEGREES, 1),
        "full_size_from": round(FULL_SIZE_FROM_SHARE * iterations),
        "rates_fall_from": round(RATES_FALL_FROM_SHARE * iterations),
        "transients_at": round(TRANSIENTS_SHARE * iterations),
        "refine_from": min(round(REFINE_FROM_SHARE * iterations), TrainingSettings.refine_from),
        "refine_until": round(refined * iterations),
        "reset_every": iterations,
        "reset_recovery": iterations,
        "opacity_penalty": None if is_mcmc else OPACITY_PENALTY,
        "max_gaussians": budget_of(views),
    }
    return TrainingSettings(**(numbers | {name: value for name, value in chosen.items() if value is not None}))


def budget_of(views: Sequence[View]) -> int:
    """Return the most Gaussians that photos of this size and number are given."""
    pixels = sum(view.width * view.height for view in views)
    return max(round(pixels / PIXELS_PER_GAUSSIAN / min(max(len(views), 1), MAX_BUDGET_PHOTOS)), 4)


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

    >>> points = ds.read_sparse_points("colmap")
    >>> ds.train(ds.read_views("capture"), ds.TrainingSettings(iterations=20), points=points).settings.iterations
    20
    """
    job = Job(
        views, settings or everyday(views), output_dir, points, overwrite, save_at, checkpoint_every, threads, report
    )
    return (loop if chosen_device(device) == "cpu" else device_run).train(job)
