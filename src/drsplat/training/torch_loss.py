"""The photometric loss of `kernels.training` in PyTorch, with its gradient in closed form.

By autograd it takes three times as many kernels, and small photos are as long in launching them as in computing.
"""

from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from ..arrays import Float32
from .metrics import C1, C2, SIGMA, WINDOW

Planes = Float32[Tensor, "3 h w"]
HALF = WINDOW // 2


class Loss(NamedTuple):
    """gradient: with respect to the image."""

    value: Float32[Tensor, ""]
    gradient: Float32[Tensor, "h w 3"]


@torch.no_grad()
def photometric_loss(
    image: Float32[Tensor, "h w 3"], target: Float32[Tensor, "h w 3"], ssim_weight: float = 0.2
) -> Loss:
    """(1 - w) L1 + w (1 - SSIM), as `kernels.training.photometric_loss`. Source: 3DGS Eq. 7; Wang et al. 2004."""
    difference = image - target
    similarity, rise = _ssim(image.permute(2, 0, 1), target.permute(2, 0, 1))
    value = torch.lerp(difference.abs().mean(), 1 - similarity, ssim_weight)
    slope = difference.sign_().mul_((1 - ssim_weight) / image.numel())
    return Loss(value, slope.sub_(rise.permute(1, 2, 0), alpha=ssim_weight))


def _ssim(x: Planes, y: Planes) -> tuple[Float32[Tensor, ""], Planes]:
    """Mean structural similarity, and its gradient: Gaussian window of 11, sigma 1.5, zeros outside.

    Of the blurred x, x x and x y the gradient blurs back: the window is symmetric.
    """
    mx, my, xx, yy, xy = _blurred(torch.stack((x, y, x * x, y * y, x * y)))
    product, squares = mx * my, mx * mx + my * my
    bright, contrast = 2 * product + C1, 2 * (xy - product) + C2
    light, spread = squares + C1, xx + yy - squares + C2
    share = 1 / (light * spread)
    similarity = bright * contrast * share
    by_mean = 2 * (my * (contrast - bright) * share - mx * similarity * (1 / light - 1 / spread))
    back = _blurred(torch.stack((by_mean, -similarity / spread, 2 * bright * share)))
    return similarity.mean(), (back[0] + 2 * x * back[1] + y * back[2]) / x.numel()


def _blurred(images: Float32[Tensor, "m 3 h w"]) -> Float32[Tensor, "m 3 h w"]:
    """Down the columns, then along the rows."""
    window = _window(images.device)
    flat = images.reshape(-1, 1, *images.shape[2:])
    flat = conv2d(flat, window.view(1, 1, -1, 1), padding=(HALF, 0))
    return conv2d(flat, window.view(1, 1, 1, -1), padding=(0, HALF)).view(images.shape)


@cache
def _window(device: torch.device) -> Float32[Tensor, " w"]:
    offsets = torch.arange(WINDOW, dtype=torch.float32, device=device) - HALF
    window = torch.exp(offsets**2 / (-2 * SIGMA**2))
    return window / window.sum()
