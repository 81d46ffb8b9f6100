"""The optimisation of `run` on a GPU: our own kernels draw, compare and step; arrays stay on the device."""

import math
import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import numpy as np

from ..base.arrays import Anywhere
from ..kernels.cuda.devices import on_host
from ..kernels.cuda.engine import Engine, cuda_engine, memory_explained
from ..kernels.cuda.training import (
    DeviceGradients,
    DevicePhoto,
    DeviceView,
    adam_step,
    forward,
    loss_window,
    normals,
    photometric_loss,
    sent_view,
)
from ..kernels.training import Rates, SceneParameters
from ..scene.views import View
from .loop import trained
from .optimizer import Optimizer, Slopes
from .run import Beginning, Job, Outcome, Run, Training
from .settings import active_sh_degree
from .training_photos import TrainingPhotos

CURE = "limit them with max_gaussians=N, or train on smaller photos"
MEMORY_DIVISOR = 4  # photos take at most a quarter of the free memory


class DeviceOptimizer(Optimizer):
    """Parameters and moments on the device."""

    def __init__(self, engine: Engine, *arrays: SceneParameters) -> None:
        super().__init__(*arrays)
        self.engine = engine

    @classmethod
    def sent(cls, optimizer: Optimizer, engine: Engine) -> "DeviceOptimizer":
        """Copy an optimizer to the device."""
        groups = optimizer.parameters, optimizer.first, optimizer.second
        return cls(engine, *(SceneParameters(*map(engine.xp.asarray, arrays)) for arrays in groups))

    def step(self, gradients: Slopes, rates: Rates, step: int, threads: int = 0) -> None:
        """Take one step of Adam, in place."""
        slopes = cast(DeviceGradients, gradients)
        adam_step(self.engine, self.parameters, self.first, self.second, slopes, rates=rates, step=step)

    def noise(self, rng: np.random.Generator, count: int) -> Any:
        return normals(self.engine, rng, count)

    def on_host(self) -> SceneParameters:
        return SceneParameters(*map(on_host, self.parameters))


class DevicePhotos:
    """Photos by index and raster, sent once as bytes while they take no more than their share of the memory."""

    def __init__(self, photos: TrainingPhotos, engine: Engine) -> None:
        self._photos, self._xp, self._room = photos, engine.xp, engine.free_bytes() // MEMORY_DIVISOR
        self._kept: dict[tuple[int, int, int], DevicePhoto] = {}

    def photo_on(self, index: int, view: View) -> DevicePhoto:
        """Return a photo on the raster of a view, which may be coarser than its own."""
        key = (index, view.width, view.height)
        if key not in self._kept:
            photo = self._photos.on_raster(*key)
            unused = None if photo.unused is None else self._xp.asarray(photo.unused.astype(np.uint8))
            sent = DevicePhoto(self._xp.asarray(np.ascontiguousarray(photo.pixels)), unused)
            size = sum(array.nbytes for array in sent if array is not None)
            if size > self._room:
                return sent
            self._kept[key] = sent
            self._room -= size
        return self._kept[key]


class DeviceRun(Run):
    """A run whose arrays live on a GPU. Schedules, order of views, density control and checkpoints are the CPU's."""

    def __init__(self, beginning: Beginning, engine: Engine) -> None:
        self.engine = engine
        super().__init__(beginning)
        self.window = loss_window(engine)
        self._cameras: dict[tuple[int, int, int], DeviceView] = {}

    def show(self, views: Sequence[View]) -> None:
        super().show(views)
        self.photos.read_all(os.cpu_count() or 1)  # else the GPU waits for each of them
        self.targets = DevicePhotos(self.photos, self.engine)

    def _learn(self, gradients: Slopes, threads: int) -> None:
        before = len(self)
        super()._learn(gradients, threads)
        if len(self) != before:
            self.engine.release()

    def _placed(self, optimizer: Optimizer) -> Optimizer:
        with memory_explained(lambda: f"at {len(optimizer):,} Gaussians, which are sent there: {CURE}"):
            return DeviceOptimizer.sent(optimizer, self.engine)

    @property
    def _zeros(self) -> Callable[..., Anywhere]:
        zeros: Callable[..., Anywhere] = self.engine.xp.zeros
        return zeros

    def _seen_and_compared(self, index: int, threads: int) -> tuple[Outcome, Slopes]:
        view = self._view(index)
        target = self.targets.photo_on(index, view)
        key = (index, view.width, view.height)
        if key not in self._cameras:
            self._cameras[key] = sent_view(self.engine, view, self.near)
        self._lap("photo")
        drawn = forward(
            self.engine, self.optimizer.parameters, self._cameras[key],
            active_sh_degree(self.settings, self.iteration), self._background(), self.settings.antialiased,
        )  # fmt: skip
        self._lap("forward")
        loss = photometric_loss(self.engine, drawn.image, target, self.settings.dssim_weight, self.window)
        self._lap("loss")
        gradients = drawn.backward(loss.gradient)
        if self.views[index].mask_path is not None:
            gradients = gradients._replace(radii=gradients.radii * (gradients.screen > 0))
        value = loss.value()  # waits for the device, which has all of this to do by now
        if not math.isfinite(value):
            raise self._diverged()
        self._lap("backward")
        outcome = Outcome(value, partial(_psnr, self.engine.xp, drawn.image, target))
        return outcome, gradients


def _psnr(xp: Any, image: Any, photo: DevicePhoto) -> float:
    error = (xp.clip(image, 0, 1) - photo.pixels * np.float32(1 / 255)) ** 2
    if photo.unused is not None:
        error = error[photo.unused == 0]
    return min(-10 * math.log10(max(float(error.mean()), 1e-30)), 99.0)


def train(job: Job, engine: Engine | None = None) -> Training:
    """Train on the device, see `loop.train`: start, photos, schedules, density control and files are those of the CPU.

    Held-out photos are rendered by the CPU's kernels, so that the measures of all devices compare.

    Raises: as `loop.train`, and MissingExtraError: no GPU, or no CuPy. DrSplatError: the device's memory is full.
    """
    return trained(
        job, partial(DeviceRun, engine=engine or cuda_engine()),
        lambda run: memory_explained(lambda: f"at {len(run):,} Gaussians, in iteration {run.iteration}: {CURE}"),
    )  # fmt: skip
