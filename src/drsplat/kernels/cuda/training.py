"""Rendering with gradients, the photometric loss and Adam's steps on a GPU: what `kernels.training` does on the CPU.

The same input gives the same bits on the same GPU: nothing is added up in the order in which threads happen to run.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...scene.views import View
from ..training import Rates, SceneParameters
from .engine import Engine, blocks_of
from .tiling import Projected, Raster, Tiles, empty, room_for_splats, sent_camera, tiles_of

PIXELS_PER_TILE = 256
SUMS_PER_SPLAT = 9  # in each tile, of gradients
ADAM_ROWS_PER_BLOCK = 32  # Gaussians of a block of adam_colors
MAX_ADAM_BLOCKS = 16384
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
WINDOW, SIGMA = 11, 1.5


class DeviceView(NamedTuple):
    """A view as the kernels read it."""

    camera: Any  # float32 (20)
    raster: Raster


class DevicePhoto(NamedTuple):
    """A photo on the device. unused: 1 where a pixel says nothing, or None."""

    pixels: Any  # uint8 (h, w, 3)
    unused: Any | None  # uint8 (h, w)


class DeviceGradients(NamedTuple):
    """Gradients as `kernels.training.Gradients`, but by the colours: the harmonics' are `along` times their basis."""

    means: Any  # float32 (n, 3)
    log_scales: Any  # float32 (n, 3)
    quats: Any  # float32 (n, 4)
    logits: Any  # float32 (n)
    along: Any  # float32 (n, 3)
    screen: Any  # float32 (n)
    radii: Any  # float32 (n)
    view: DeviceView
    active: int  # coefficients of the harmonics that are used


class DeviceLoss(NamedTuple):
    """Loss and its gradient by the image. sums: of SSIM and of |image - photo|, on the device."""

    sums: Any  # float64 (2)
    gradient: Any  # float32 (h, w, 3)
    size: int  # numbers of the image
    ssim_weight: float

    def value(self) -> float:
        """Return (1 - w) L1 + w (1 - SSIM); waits for the device."""
        ssim, l1 = (float(total) / self.size for total in self.sums.tolist())
        return (1 - self.ssim_weight) * l1 + self.ssim_weight * (1 - ssim)


class DevicePass(NamedTuple):
    """A forward pass, kept for its backward pass; change no parameter in between."""

    engine: Engine
    parameters: SceneParameters
    view: DeviceView
    active: int
    antialiased: bool
    projected: Projected
    colors: Any  # float32 (n, 4)
    tiles: Tiles
    image: Any  # float32 (h, w, 3)

    def backward(self, image_gradient: Any) -> DeviceGradients:
        """Return the parameters' gradients, given the loss's gradient by the image."""
        engine, xp, raster, tiles = self.engine, self.engine.xp, self.view.raster, self.tiles
        sums = empty(engine, SUMS_PER_SPLAT * len(tiles.ids), xp.float32)
        engine.launch(
            "draw_colors_backward", raster.num_tiles, PIXELS_PER_TILE, tiles.starts, tiles.ids, tiles.rows,
            self.projected.splats, self.colors, raster.width, raster.height, raster.columns, self.image,
            image_gradient, sums,
        )  # fmt: skip
        count = len(self.parameters.means)
        sizes = ((count, 3), (count, 3), (count, 4), count, (count, 3), count, count)
        gradients = [xp.empty(size, xp.float32) for size in sizes]
        engine.launch(
            "parameter_gradients", blocks_of(count), 256,
            *_scene(self.parameters, self.view, self.active, self.antialiased), self.projected.extents, self.colors,
            self.projected.counts, tiles.row_ends, sums, *gradients,
        )  # fmt: skip
        means, log_scales, quats, logits, along, screen, radii = gradients
        return DeviceGradients(means, log_scales, quats, logits, along, screen, radii, self.view, self.active)


def _scene(parameters: SceneParameters, view: DeviceView, active: int, antialiased: bool) -> tuple[object, ...]:
    """Return what the kernels that read parameters take first."""
    size = len(parameters.means), parameters.sh.shape[1], active
    return (*parameters, *size, view.camera, view.raster.width, view.raster.height, antialiased)


def sent_view(engine: Engine, view: View, near: float) -> DeviceView:
    """Return a view on the device. Raises: InputError: see `camera_numbers`."""
    return DeviceView(sent_camera(engine, view, near), Raster(*view.size))


def forward(
    engine: Engine, parameters: SceneParameters, view: DeviceView, sh_degree: int, background: Any, antialiased: bool
) -> DevicePass:
    """Render the scene as it stands, as `kernels.training.forward`. parameters: arrays of the device.

    Raises: DrSplatError: more splats in tiles than can be sorted.
    Source: 3DGS Sec. 4-5.
    """
    xp, count, raster = engine.xp, len(parameters.means), view.raster
    active = (sh_degree + 1) ** 2
    projected, colors = room_for_splats(engine, count), xp.empty((count, 4), xp.float32)
    splats, extents, keys, counts = projected
    engine.launch(
        "project_parameters", blocks_of(count), 256, *_scene(parameters, view, active, antialiased), splats, extents,
        colors, keys, counts,
    )  # fmt: skip
    tiles = tiles_of(engine, projected, raster, training=True)
    image = xp.empty((raster.height, raster.width, 3), xp.float32)
    engine.launch(
        "draw_colors", raster.num_tiles, PIXELS_PER_TILE, tiles.starts, tiles.ids, splats, colors, raster.width,
        raster.height, raster.columns, *map(float, background), image,
    )  # fmt: skip
    return DevicePass(engine, parameters, view, active, antialiased, projected, colors, tiles, image)


def loss_window(engine: Engine) -> Any:
    """Return the window of SSIM: 11 numbers, Gaussian, sigma 1.5."""
    offsets = np.arange(WINDOW) - WINDOW // 2
    window = np.exp(-(offsets**2) / (2 * SIGMA**2))
    return engine.xp.asarray((window / window.sum()).astype(np.float32))


def photometric_loss(engine: Engine, image: Any, photo: DevicePhoto, ssim_weight: float, window: Any) -> DeviceLoss:
    """Return the loss as `kernels.training.photometric_loss`; where the photo says nothing, nothing is learnt.

    window: `loss_window`.
    """
    xp, (height, width) = engine.xp, image.shape[:2]
    blocks = Raster(width, height).num_tiles
    partials, sums = xp.empty((9, height, width), xp.float32), xp.empty((2, blocks), xp.float64)
    gradient, totals = xp.empty((height, width, 3), xp.float32), xp.empty(2, xp.float64)
    shared = image, photo.pixels, photo.unused, width, height, window, partials
    engine.launch("ssim_partials", blocks, 256, *shared, sums[0])
    engine.launch("loss_gradient", blocks, 256, *shared, float(ssim_weight), gradient, sums[1])
    engine.launch("add_blocks", 2, 256, sums, blocks, totals)
    return DeviceLoss(totals, gradient, 3 * height * width, ssim_weight)


def adam_step(
    engine: Engine,
    parameters: SceneParameters,
    first: SceneParameters,
    second: SceneParameters,
    gradients: DeviceGradients,
    *,
    rates: Rates,
    step: int,
) -> None:
    """Take Adam's step in place: parameters and both moments change. step counts from 1.

    Source: Kingma & Ba 2015, Algorithm 1.
    """
    count, coefficients = parameters.sh.shape[:2]
    bias = 1 - BETA1**step
    numbers = BETA1, BETA2, float(1 / math.sqrt(1 - BETA2**step)), EPSILON
    constant, rest = rates.sh / bias, rates.sh_rest / bias
    # the harmonics first: their gradients need the means of the pass
    engine.launch(
        "adam_colors", blocks_of(count, ADAM_ROWS_PER_BLOCK), 256, count, coefficients, gradients.active,
        parameters.means, gradients.view.camera, gradients.along, parameters.sh, first.sh, second.sh,
        constant, rest, *numbers,
    )  # fmt: skip
    engine.launch(
        "adam_shapes", min(blocks_of(11 * count), MAX_ADAM_BLOCKS), 256, count, *parameters[:4], *gradients[:4],
        *first[:4], *second[:4], *(rate / bias for rate in rates[:4]), *numbers,
    )  # fmt: skip


def normals(engine: Engine, rng: np.random.Generator, count: int) -> Any:
    """Draw normal numbers on the device, float32 (count, 3); `rng` decides which."""
    drawn = engine.xp.empty((count, 3), engine.xp.float32)
    low, high = (int(word) for word in rng.integers(1 << 32, size=2))
    engine.launch("draw_normals", blocks_of(3 * count, 4 * 256), 256, drawn, 3 * count, low, high)
    return drawn
