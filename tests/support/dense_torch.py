"""A plain dense rasterizer and loss in torch: every Gaussian at every pixel, derivatives by autograd.

Written from the formulas, without tiles, lists or early exits: to compare with, and to be a rival in a
benchmark. Semantics as in docs/method.md; in float64 or float32, as the parameters are. It takes memory
for some twenty (N, H, W) arrays.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d, normalize

from drsplat.scene.views import View

TILE = 16


class Scene(NamedTuple):
    """Parameters before activation, named as in `SceneParameters`."""

    means: Tensor
    log_scales: Tensor
    quats: Tensor
    logits: Tensor
    sh: Tensor


class Dense(NamedTuple):
    """image: (h, w, 3). offsets: (n, 2) zeros that were added to the projected centres."""

    image: Tensor
    offsets: Tensor


def render(scene: Scene, view: View, sh_degree: int, background: Tensor, antialiased: bool = False) -> Dense:
    """The image, and a leaf whose gradient is that by the projected centres in pixels."""
    pose = torch.tensor(view.cam_from_world, dtype=scene.means.dtype)
    points = scene.means @ pose[:3, :3].T + pose[:3, 3]
    offsets = torch.zeros_like(points[:, :2]).requires_grad_()
    principal = torch.tensor(view.K[:2, 2], dtype=points.dtype)
    centers = focal_of(view, points) * points[:, :2] / points[:, 2:] + principal + offsets
    flat = flat_covariances(scene, points, view)
    colors = view_colors(scene, view, sh_degree)
    opacities = torch.sigmoid(scene.logits)
    if antialiased:
        sharp = flat - 0.3 * torch.eye(2, dtype=flat.dtype)
        opacities = opacities * torch.sqrt(torch.linalg.det(sharp) / torch.linalg.det(flat))

    order = torch.sort(points[:, 2].detach().float(), stable=True).indices
    visible = (points[:, 2] > 0.2) & (opacities >= 1 / 255)
    reached = visible[:, None, None] & in_tiles(centers.detach(), flat.detach(), view)
    alphas = opacities[:, None, None] * falloff(centers, flat, view)
    alphas = torch.where(reached & (alphas >= 1 / 255), alphas.clamp(max=0.99), 0.0)[order]
    alphas = alphas * (torch.cumprod(1 - alphas.detach(), 0) >= 1e-4)
    after = torch.cumprod(1 - alphas, 0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    image = torch.einsum("nhw,nc->hwc", alphas * before, colors[order])
    return Dense(image + after[-1][..., None] * background, offsets)


def photometric_loss(image: Tensor, target: Tensor, ssim_weight: float = 0.2) -> Tensor:
    """(1 - w) L1 + w (1 - SSIM), by convolution with a window of 11 x 11."""
    offsets = torch.arange(11, dtype=image.dtype) - 5
    window = torch.exp(-(offsets**2) / (2 * 1.5**2))
    window = window / window.sum()
    kernel = torch.outer(window, window).expand(3, 1, 11, 11)

    def blurred(values: Tensor) -> Tensor:
        return conv2d(values.permute(2, 0, 1), kernel, padding=5, groups=3)

    x, y = blurred(image), blurred(target)
    xx, yy = blurred(image * image) - x * x, blurred(target * target) - y * y
    xy = blurred(image * target) - x * y
    above = (2 * x * y + 0.01**2) * (2 * xy + 0.03**2)
    ssim = above / ((x * x + y * y + 0.01**2) * (xx + yy + 0.03**2))
    return (1 - ssim_weight) * (image - target).abs().mean() + ssim_weight * (1 - ssim.mean())


def flat_covariances(scene: Scene, points: Tensor, view: View) -> Tensor:
    """(n, 2, 2): J W Sigma W^T J^T + 0.3 I, J taken within 1.3 times the field of view."""
    focal, size = focal_of(view, points), points.new_tensor([view.width, view.height])
    limits = 1.3 * size / (2 * focal)
    slopes = torch.clamp(points[:, :2] / points[:, 2:], -limits, limits)
    scaled = focal / points[:, 2:]
    jacobian = torch.cat([torch.diag_embed(scaled), (-scaled * slopes)[:, :, None]], 2)
    pose = torch.tensor(view.cam_from_world, dtype=points.dtype)
    axes = rotations(scene.quats) * torch.exp(scene.log_scales)[:, None, :]
    flat = jacobian @ pose[:3, :3] @ axes
    return flat @ flat.transpose(1, 2) + 0.3 * torch.eye(2, dtype=points.dtype)


def rotations(quats: Tensor) -> Tensor:
    """(n, 3, 3), by v -> v + 2 w (u x v) + 2 u x (u x v) for q = (w, u) of unit length."""
    unit = normalize(quats, dim=1, eps=0.0)
    w, u = unit[:, :1, None], unit[:, 1:]
    zero = torch.zeros_like(u[:, 0])
    x, y, z = u.unbind(1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    return torch.eye(3, dtype=quats.dtype) + 2 * w * cross + 2 * cross @ cross


def falloff(centers: Tensor, flat: Tensor, view: View) -> Tensor:
    """(n, h, w): exp(-d^T cov^-1 d / 2) at the pixel centres."""
    columns = torch.arange(view.width) + 0.5 - centers[:, 0, None]
    rows = torch.arange(view.height) + 0.5 - centers[:, 1, None]
    inverse = torch.linalg.inv(flat)[:, :, :, None, None]
    dx, dy = columns[:, None, :], rows[:, :, None]
    squares = inverse[:, 0, 0] * dx * dx + 2 * inverse[:, 0, 1] * dx * dy
    return torch.exp(-0.5 * (squares + inverse[:, 1, 1] * dy * dy))


def in_tiles(centers: Tensor, flat: Tensor, view: View) -> Tensor:
    """(n, h, w): the pixels of the tiles that the 3-sigma square touches."""
    mid, det = 0.5 * (flat[:, 0, 0] + flat[:, 1, 1]), torch.linalg.det(flat)
    spread = torch.sqrt(torch.clamp(mid * mid - det, min=0.1))
    reach = torch.ceil(3 * torch.sqrt(mid + spread))[:, None]
    first = torch.floor((centers - 0.5 - reach) / TILE)[:, :, None]
    end = torch.floor((centers - 0.5 + reach + TILE - 1) / TILE)[:, :, None]
    sides = (torch.arange(n) // TILE for n in (view.width, view.height))
    x, y = ((first[:, a] <= t) & (t < end[:, a]) for a, t in enumerate(sides))
    return x[:, None, :] & y[:, :, None]


def view_colors(scene: Scene, view: View, sh_degree: int) -> Tensor:
    """(n, 3): max(0, 0.5 + SH) of the active degrees."""
    center = torch.tensor(view.center, dtype=scene.means.dtype)
    x, y, z = normalize(scene.means - center, dim=1, eps=0.0).unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [0.28209479177387814 * torch.ones_like(x)]
    basis += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    basis += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z]
    basis += [0.31539156525252005 * (2 * zz - xx - yy)]
    basis += [-1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy)]
    basis += [-0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z]
    basis += [-0.4570457994644658 * y * (4 * zz - xx - yy)]
    basis += [0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy)]
    basis += [-0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy)]
    basis += [-0.5900435899266435 * x * (xx - 3 * yy)]
    active = (sh_degree + 1) ** 2
    colors = torch.einsum("nk,nkc->nc", torch.stack(basis[:active], 1), scene.sh[:, :active])
    return torch.clamp(0.5 + colors, min=0.0)


def focal_of(view: View, like: Tensor) -> Tensor:
    return torch.tensor([view.K[0, 0], view.K[1, 1]], dtype=like.dtype)
