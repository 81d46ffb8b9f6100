"""gsplat on the task of a benchmark: our photos, schedule and start, its rasterisation, torch's fused Adam.

The number of Gaussians is fixed: no density control, on either side. Needs `pip install torch gsplat`, a CUDA GPU and a
compiler.

    run = GsplatRun(beginning)  # as drsplat.training.run.Run
    run.step()
"""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import Parameter
from torch.nn.functional import conv2d

from drsplat.kernels.training import SceneParameters
from drsplat.training.metrics import C1, C2, SIGMA, WINDOW
from drsplat.training.optimizer import Optimizer
from drsplat.training.run import Beginning, Outcome, Run
from drsplat.training.settings import active_sh_degree

BLUR_PX2 = 0.3
HALF = WINDOW // 2
NAMES = ("means", "log_scales", "quats", "logits", "sh", "sh_rest")  # as the rates are named


class GsplatRun(Run):
    """A run of a fixed number of Gaussians whose parameters, photos and cameras are torch's."""

    def __init__(self, beginning: Beginning, rasterization: Callable[..., Any] | None = None, device: str = "cuda"):
        """rasterization: called as gsplat's, which is the default."""
        super().__init__(beginning)
        self.device, self.rasterization = device, rasterization or _gsplat_rasterization()
        p = self.optimizer.parameters
        columns = (*p[:4], p.sh[:, :1], p.sh[:, 1:])
        self.tensors = {name: Parameter(self._sent(column)) for name, column in zip(NAMES, columns, strict=True)}
        groups = [{"params": [tensor], "lr": 0.0} for tensor in self.tensors.values()]
        self.adam = torch.optim.Adam(groups, eps=1e-15, fused=device == "cuda")
        self.cameras = [(self._sent(view.cam_from_world[None]), self._sent(view.K[None])) for view in self.views]
        self.targets = [self._photo(index) for index in range(len(self.views))]

    def step(self, threads: int = 0) -> Outcome:
        self._since = time.perf_counter()
        self.iteration += 1
        index = self.order.next(self.rng)
        self._lap("photo")
        image = self._image(index)
        self._lap("forward")
        shown, target = image.detach(), self._target(index)
        value, gradient = photometric_loss(shown, target, self.settings.dssim_weight)
        self._lap("loss")
        image.backward(gradient)
        if not math.isfinite(value := float(value)):  # waits for the device
            raise self._diverged()
        self._lap("backward")
        for group, rate in zip(self.adam.param_groups, self._rates(), strict=True):
            group["lr"] = rate
        self.adam.step()
        self.adam.zero_grad()
        self._lap("optimizer")
        return Outcome(value, partial(_psnr, shown, target))

    def downloaded(self) -> Optimizer:
        """Return a copy of the parameters on the host, with zero moments."""
        tensors = {name: tensor.detach().cpu().numpy() for name, tensor in self.tensors.items()}
        sh = np.concatenate([tensors.pop("sh"), tensors.pop("sh_rest")], axis=1)
        return Optimizer(SceneParameters(**tensors, sh=sh))

    def _image(self, index: int) -> Tensor:
        view, (pose, K), tensors = self.views[index], self.cameras[index], self.tensors
        images, _, _ = self.rasterization(
            means=tensors["means"], quats=tensors["quats"], scales=torch.exp(tensors["log_scales"]),
            opacities=torch.sigmoid(tensors["logits"]), colors=torch.cat([tensors["sh"], tensors["sh_rest"]], 1),
            sh_degree=active_sh_degree(self.settings, self.iteration), backgrounds=self._sent(self._background()[None]),
            viewmats=pose, Ks=K, width=view.width, height=view.height, near_plane=self.near, eps2d=BLUR_PX2,
            packed=False, rasterize_mode="antialiased" if self.settings.antialiased else "classic",
        )  # fmt: skip
        return images[0]

    def _sent(self, array: np.ndarray) -> Tensor:
        return torch.tensor(array, dtype=torch.float32, device=self.device)

    def _photo(self, index: int) -> Tensor:
        """Return a photo's bytes on the device. Raises: ValueError: pixels that say nothing, which need masks."""
        photo = self.photos[index]
        if photo.unused is not None:
            raise ValueError(f"{self.views[index].name}: photos with masks or edges are not compared")
        return torch.tensor(photo.pixels, device=self.device)

    def _target(self, index: int) -> Tensor:
        return self.targets[index] * (1 / 255)


def _gsplat_rasterization() -> Callable[..., Any]:
    from gsplat import rasterization

    return rasterization


def _psnr(image: Tensor, target: Tensor) -> float:
    error = float(((image.clamp(0, 1) - target) ** 2).mean())
    return min(-10 * math.log10(max(error, 1e-30)), 99.0)


@torch.no_grad()
def photometric_loss(image: Tensor, target: Tensor, ssim_weight: float) -> tuple[Tensor, Tensor]:
    """Return (1 - w) L1 + w (1 - SSIM) of two images (h, w, 3), and its gradient by the first in closed form."""
    difference = image - target
    similarity, rise = _ssim(image.permute(2, 0, 1), target.permute(2, 0, 1))
    value = torch.lerp(difference.abs().mean(), 1 - similarity, ssim_weight)
    slope = difference.sign_().mul_((1 - ssim_weight) / image.numel())
    return value, slope.sub_(rise.permute(1, 2, 0), alpha=ssim_weight)


def _ssim(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean structural similarity of planes (3, h, w), and its gradient: the window is symmetric."""
    mx, my, xx, yy, xy = _blurred(torch.stack((x, y, x * x, y * y, x * y)))
    product, squares = mx * my, mx * mx + my * my
    bright, contrast = 2 * product + C1, 2 * (xy - product) + C2
    light, spread = squares + C1, xx + yy - squares + C2
    share = 1 / (light * spread)
    similarity = bright * contrast * share
    by_mean = 2 * (my * (contrast - bright) * share - mx * similarity * (1 / light - 1 / spread))
    back = _blurred(torch.stack((by_mean, -similarity / spread, 2 * bright * share)))
    return similarity.mean(), (back[0] + 2 * x * back[1] + y * back[2]) / x.numel()


def _blurred(images: Tensor) -> Tensor:
    """Blur images (m, 3, h, w) with the Gaussian window, down the columns, then along the rows."""
    offsets = torch.arange(WINDOW, dtype=torch.float32, device=images.device) - HALF
    window = torch.exp(offsets**2 / (-2 * SIGMA**2))
    window = window / window.sum()
    flat = images.reshape(-1, 1, *images.shape[2:])
    flat = conv2d(flat, window.view(1, 1, -1, 1), padding=(HALF, 0))
    return conv2d(flat, window.view(1, 1, 1, -1), padding=(0, HALF)).view(images.shape)
