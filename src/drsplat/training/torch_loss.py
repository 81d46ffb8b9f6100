"""The photometric loss of `kernels.training` in PyTorch, with derivatives by autograd."""

import torch
from jaxtyping import Float32
from torch import Tensor
from torch.nn.functional import conv2d

from .metrics import C1, C2, SIGMA, WINDOW

Image = Float32[Tensor, "h w 3"]


def photometric_loss(image: Image, target: Image, ssim_weight: float = 0.2) -> Float32[Tensor, ""]:
    """(1 - w) L1 + w (1 - SSIM), as `kernels.training.photometric_loss`. Source: 3DGS Eq. 7; Wang et al. 2004."""
    l1 = (image - target).abs().mean()
    loss: Tensor = (1 - ssim_weight) * l1 + ssim_weight * (1 - ssim(image, target))
    return loss


def ssim(image: Image, target: Image) -> Float32[Tensor, ""]:
    """Mean structural similarity: Gaussian window of 11, sigma 1.5, zeros outside."""
    moments = (image, target, image * image, target * target, image * target)
    x, y, xx, yy, xy = _blurred(torch.stack(moments))
    luminance = (2 * x * y + C1) / (x * x + y * y + C1)
    structure = (2 * (xy - x * y) + C2) / (xx - x * x + yy - y * y + C2)
    mean: Tensor = (luminance * structure).mean()
    return mean


def _blurred(images: Float32[Tensor, "m h w 3"]) -> Float32[Tensor, "m 3 h w"]:
    """Down the columns, then along the rows."""
    offsets = torch.arange(WINDOW, dtype=torch.float32, device=images.device) - WINDOW // 2
    window = torch.exp(offsets**2 / (-2 * SIGMA**2))
    window = window / window.sum()
    planes = images.permute(0, 3, 1, 2)
    flat = planes.reshape(-1, 1, *planes.shape[2:])
    flat = conv2d(flat, window.view(1, 1, -1, 1), padding=(WINDOW // 2, 0))
    return conv2d(flat, window.view(1, 1, 1, -1), padding=(0, WINDOW // 2)).view(planes.shape)
