"""One optimisation between two iterations: everything that decides the next one, and the step.

A training's job, its status while it is under way, and the beginning of its optimisation.
"""

import json
import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from ..base.arrays import Anywhere, Arrays, ArraysByName, Float32, Image, Vector3
from ..errors import DrSplatError, InputError
from ..formats.captures import SparsePoints
from ..kernels.training import Rates, forward, photometric_loss
from ..scene.gaussians import Gaussians, near_plane
from ..scene.views import View
from .density import AdaptiveDensity, MonteCarlo
from .evaluation import Evaluation
from .metrics import psnr
from .optimizer import Optimizer, Slopes
from .settings import TrainingSettings, active_sh_degree, divisor, means_rate, other_rates_share
from .start import scene_extent
from .training_photos import Photo, TrainingPhotos, ViewOrder

CHECKPOINT_EVERY = 1000
SAVE_AT = (7000,)
MAX_HELD_OUT_LOSS_DB = 10.0  # well covered captures lose 3 dB on held-out photos, sparse ones up to 8


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
    origin: Vector3 = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False)
class Training:
    """The result of a training.

    evaluation: on the held-out photos; None when there are none. psnr_train: mean over as many of the photos that
    it was trained on, in dB. seconds: of optimisation, over all sittings. stage_seconds: the same by stage.
    history: evaluations on the way. start: points that it started from, by where they came from. num_masked: photos,
    trained on or held out, of which masks leave pixels out: these take no part, in measures neither. num_transient:
    photos, of both kinds, that show something that moves, which was not learnt.
    """

    gaussians: Gaussians
    settings: TrainingSettings
    evaluation: Evaluation | None
    seconds: float
    stage_seconds: dict[str, float]
    history: list[dict[str, object]]
    psnr_train: float
    start: dict[str, int]
    num_masked: int = 0
    num_transient: int = 0

    @property
    def held_out_far_below(self) -> bool:
        """True where held-out photos are rendered so much worse that the scene is fog from other viewpoints."""
        test = self.evaluation
        return test is not None and self.psnr_train - test.psnr > MAX_HELD_OUT_LOSS_DB

    def measures(self) -> dict[str, object]:
        """Return the main numbers, for JSON."""
        return {
            "psnr_test": self.evaluation.psnr if self.evaluation else None,
            "psnr_train": self.psnr_train,
            "held_out_far_below": self.held_out_far_below,
            "ssim_test": self.evaluation.ssim if self.evaluation else None,
            "num_gaussians": len(self.gaussians),
            "iterations": self.settings.iterations,
            "seconds": self.seconds,
            "num_test_views": len(self.evaluation.views) if self.evaluation else 0,
            "num_masked_views": self.num_masked,
            "num_views_with_transients": self.num_transient,
            "stage_seconds": self.stage_seconds,
            "start": self.start,
        }


FINITE_CHECK_EVERY = 100
MIN_SIDE_PIXELS = 32  # of a photo that is made coarse; three windows of SSIM
FACTS = ("iteration", "seconds", "stage_seconds", "history", "start")
STAGES = ("photo", "forward", "loss", "backward", "optimizer", "density")


class Outcome(NamedTuple):
    """Outcome of one iteration. psnr: of its photo, dB, at most 99; computed when it is called."""

    loss: float
    psnr: Callable[[], float]


class Run:
    """State of an optimisation; two runs of equal state take the same steps to the bit."""

    def __init__(self, beginning: Beginning) -> None:
        self.origin, self.rng = beginning.origin, beginning.rng
        self.settings = beginning.settings
        self.optimizer = self._placed(beginning.optimizer)
        self.near = near_plane(beginning.optimizer.parameters.means)
        self.photos = TrainingPhotos(beginning.views, self.settings.photo_memory_bytes)
        self.show(beginning.views)
        self.extent = scene_extent(self.views)
        self.order = ViewOrder(len(self.views))
        self.density = (
            MonteCarlo(self.settings, self.extent, len(self))
            if self.settings.strategy == "mcmc"
            else AdaptiveDensity(self.settings, self.extent, len(self), self._zeros)
        )
        self.iteration = 0
        self.seconds = 0.0
        self.history: list[dict[str, object]] = []
        self.start: dict[str, int] = {}
        self.stage_seconds = dict.fromkeys(STAGES, 0.0)
        self._since = time.perf_counter()

    def show(self, views: Sequence[View]) -> None:
        """Take these photos from now on: the same ones, perhaps with other masks."""
        self.photos, self.views = self.photos.with_masks_of(views), views

    def __len__(self) -> int:
        """Return the present number of Gaussians."""
        return len(self.optimizer)

    def _placed(self, optimizer: Optimizer) -> Optimizer:
        """Return the optimizer where its steps are taken."""
        return optimizer

    @property
    def _zeros(self) -> Callable[..., Anywhere]:
        """`zeros` of the library whose arrays the gradients are."""
        return np.zeros

    def step(self, threads: int = 0) -> Outcome:
        """Run the next iteration. Raises: DrSplatError: the loss is no longer a number."""
        self._since = time.perf_counter()
        self.iteration += 1
        self.density.before_step(self.optimizer, self.iteration)
        outcome, gradients = self._seen_and_compared(self.order.next(self.rng), threads)
        self._learn(gradients, threads)
        return outcome

    def _seen_and_compared(self, index: int, threads: int) -> tuple[Outcome, Slopes]:
        """Draw a photo's view and compare. Raises: DrSplatError: the loss is no longer a number."""
        view = self._view(index)
        photo = self.photos.on_raster(index, *view.size)
        target = photo.colors()
        self._lap("photo")
        drawn = forward(
            self.optimizer.parameters, view, active_sh_degree(self.settings, self.iteration), self._background(),
            near=self.near, antialiased=self.settings.antialiased, threads=threads,
        )  # fmt: skip
        self._lap("forward")
        # the loss; where the photo is masked, the rendering is its own target and nothing is learnt
        unused = photo.unused
        if unused is not None:
            target[unused] = drawn.image[unused]
        loss = photometric_loss(drawn.image, target, self.settings.dssim_weight, threads=threads)
        if not math.isfinite(loss.value):
            raise self._diverged()
        if unused is not None:
            loss.gradient[unused] = 0
        self._lap("loss")
        step = self.optimizer.harmonics_step(self._rates(), self.iteration)
        gradients = drawn.backward(loss.gradient, step)
        if photo.left_out is not None:
            # Gaussians that only left-out pixels show are unseen: density control counts who is seen
            gradients = gradients._replace(radii=np.where(gradients.screen > 0, gradients.radii, np.float32(0)))
        self._lap("backward")
        return Outcome(loss.value, partial(_psnr, drawn.image, target, photo)), gradients

    def _view(self, index: int) -> View:
        """Return a view on the raster of this iteration: no shorter than MIN_SIDE_PIXELS for being coarse."""
        view, wanted = self.views[index], divisor(self.settings, self.iteration)
        while wanted > 1 and min(view.size) < MIN_SIDE_PIXELS * wanted:
            wanted = max(wanted / 2, 1.0)
        return view if wanted == 1 else view.resized(int(view.width / wanted), int(view.height / wanted))

    def _background(self) -> Float32[np.ndarray, "3"]:
        if self.settings.background == "random":
            return self.rng.random(3, np.float32)
        return np.array(self.settings.backdrop, np.float32)

    def _learn(self, gradients: Slopes, threads: int) -> None:
        rates = self._rates()
        self.density.observe(gradients, self.iteration)
        self.density.penalize(self.optimizer, gradients)
        self._lap("density")
        self.optimizer.step(gradients, rates, self.iteration, threads)
        if self.settings.colors_in_bytes:
            self.optimizer.limit_colors()
        self._lap("optimizer")
        with np.errstate(over="ignore", invalid="ignore"):  # looked for below
            self.density.after_step(self.optimizer, self.iteration, self.rng, rates.means)
        if self.iteration % FINITE_CHECK_EVERY == 0 and not self.optimizer.is_finite():
            raise self._diverged()
        self._lap("density")

    def _diverged(self) -> DrSplatError:
        return DrSplatError(
            f"iteration {self.iteration}: the optimisation has left the finite numbers. Check that "
            "photos and poses belong together; smaller rates help where the scene's unit is extreme"
        )

    def _rates(self) -> Rates:
        s, share = self.settings, other_rates_share(self.settings, self.iteration)
        others = s.scales_rate, s.quats_rate, s.logits_rate, s.sh_rate, s.sh_rest_rate
        return Rates(means_rate(s, self.iteration) * self.extent, *(rate * share for rate in others))

    def _lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.stage_seconds[stage] += now - self._since
        self._since = now

    def gaussians(self) -> Gaussians:
        """Return the present scene in world coordinates. Raises: as `Optimizer.gaussians`."""
        return replace(self.optimizer.gaussians(), origin=self.origin, antialiased=self.settings.antialiased)

    def state(self) -> tuple[Arrays, dict[str, str]]:
        """Return the arrays and texts from which `restore` goes on."""
        arrays = self.optimizer.state() | self.density.state() | self.order.state()
        texts = {name: json.dumps(getattr(self, name)) for name in FACTS}
        return arrays, texts | {"rng": json.dumps(self.rng.bit_generator.state)}

    def restore(self, arrays: ArraysByName, texts: Mapping[str, str]) -> None:
        """Become the run that `state` was taken of."""
        self.optimizer = self._placed(Optimizer.from_state(arrays))
        self.density.restore(arrays)
        self.order.restore(arrays)
        self.rng.bit_generator.state = json.loads(texts["rng"])
        for name in FACTS:
            setattr(self, name, json.loads(texts[name]))


R = TypeVar("R", bound=Run)


def _psnr(image: Image, target: Image, photo: Photo) -> float:
    return min(psnr(np.clip(image, 0, 1), target, photo.unused), 99.0)
