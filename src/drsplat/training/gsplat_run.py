"""The optimisation of `run`, on a device: gsplat renders, torch differentiates and takes the steps."""

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..scene.views import View
from .gsplat_strategy import DefaultControl, MonteCarloControl, Strategies
from .job import Beginning
from .optimizer import Optimizer
from .run import Outcome, Run
from .schedules import active_sh_degree
from .torch_loss import photometric_loss
from .torch_parameters import DeviceParameters
from .torch_photos import DevicePhotos

BLUR = 0.3  # square pixels, added to every splat's covariance, as the kernels add it


class Engine(NamedTuple):
    """Functions that render and refine, and a device. rasterization: called as that of gsplat 1.5."""

    rasterization: Callable[..., Any]
    strategies: Strategies
    device: str


class DeviceRun(Run):
    """A run whose parameters live on a device; `optimizer` is their copy on the host.

    Schedules, order of views, photos and checkpoints are those of the CPU. It is not the same to the
    bit each time: sums on a GPU have no order.
    """

    _copy: Optimizer | None

    def __init__(self, beginning: Beginning, engine: Engine) -> None:
        super().__init__(beginning)
        self.engine = engine
        self.targets = DevicePhotos(self.photos, engine.device)
        self.cameras = [(self._sent(view.cam_from_world), self._sent(view.K)) for view in self.views]
        self._upload()

    def __len__(self) -> int:
        return len(self.scene) if self._copy is None else len(self._copy)

    @property
    def optimizer(self) -> Optimizer:
        """A copy on the host, made when it is asked for."""
        if self._copy is None:
            self._copy = self.scene.download()
        return self._copy

    @optimizer.setter
    def optimizer(self, optimizer: Optimizer) -> None:
        self._copy = optimizer

    def _upload(self) -> None:
        self.scene = DeviceParameters(self.optimizer, self.iteration, self.engine.device)
        control = MonteCarloControl if self.settings.strategy == "mcmc" else DefaultControl
        self.control: MonteCarloControl | DefaultControl = control(
            self.settings, self.extent, self.scene, self.engine.strategies
        )

    def step(self, threads: int = 0) -> Outcome:
        self._since = time.perf_counter()
        self.iteration += 1
        self._copy = None
        self.control.before_step(self.iteration)
        # a stream of its own for each iteration: a run that goes on needs no state of it
        torch.manual_seed((self.settings.seed << 32 | self.iteration) % 2**63)
        index = self.order.next(self.rng)
        view = self._view(index)
        coarse = view is not self.views[index]
        target, outside = self.targets.smaller(index, view.width, view.height) if coarse else self.targets[index]
        self._lap("photo")
        image, seen = self._rendered(index, view)
        seen["masked"] = self.views[index].mask_path is not None
        self._lap("forward")
        outcome = self._compared(image, target, outside, seen)
        self._lap("backward")
        self._learnt(seen)
        return outcome

    def _rendered(self, index: int, view: View) -> tuple[Tensor, dict[str, Any]]:
        tensors = self.scene.tensors
        pose, K = self.cameras[index]
        K = K if view is self.views[index] else self._sent(view.K)
        images, _, seen = self.engine.rasterization(
            means=tensors["means"], quats=tensors["quats"], scales=torch.exp(tensors["scales"]),
            opacities=torch.sigmoid(tensors["opacities"]), colors=self.scene.sh,
            sh_degree=active_sh_degree(self.settings, self.iteration), backgrounds=self._sent(self._background()),
            viewmats=pose, Ks=K, width=view.width, height=view.height,
            near_plane=self.near, eps2d=BLUR, packed=False,
            rasterize_mode="antialiased" if self.settings.antialiased else "classic",
        )  # fmt: skip
        return images[0], seen

    def _sent(self, array: np.ndarray) -> Tensor:
        """One camera's."""
        return torch.tensor(array[None], dtype=torch.float32, device=self.engine.device)

    def _compared(self, image: Tensor, target: Tensor, outside: Tensor | None, seen: dict[str, Any]) -> Outcome:
        """Loss and gradients. Where the photo says nothing, the rendering is its own target and learns nothing."""
        shown = image.detach()
        if outside is not None:
            target = torch.where(outside, shown, target)
        loss = photometric_loss(shown, target, self.settings.dssim_weight)
        if outside is not None:
            loss.gradient.masked_fill_(outside, 0)
        self._lap("loss")
        self.control.before_backward(seen, self.iteration)
        penalty = self.control.penalty()
        torch.autograd.backward([image, *penalty], [loss.gradient, *(None for _ in penalty)])
        value = float(loss.value)  # the first that waits for the device, which has all of this to do by now
        if not math.isfinite(value):
            raise self._diverged()
        return Outcome(value, partial(_psnr, shown, target))

    def _learnt(self, seen: dict[str, Any]) -> None:
        rates = self._rates()
        self.scene.step(rates)
        if self.settings.colors_in_bytes:
            self.scene.limit_colors()
        self._lap("optimizer")
        self.control.after_step(seen, self.iteration, rates.means)
        self._lap("density")

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Arrays and texts as of a run on the CPU."""
        self.control.tell(self.density)
        return super().state()

    def restore(self, arrays: Mapping[str, np.ndarray], texts: Mapping[str, str]) -> None:
        """Become the run that `state` was taken of."""
        super().restore(arrays, texts)
        self._upload()
        self.control.learn(self.density)


def _psnr(image: Tensor, target: Tensor) -> float:
    error = float(((image.clamp(0, 1) - target) ** 2).mean())
    return min(-10 * math.log10(max(error, 1e-30)), 99.0)
