"""Colours of classes, on Gaussians and in pictures with a legend."""

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..base.arrays import Float32, Ids, OtherPixels, PixelNumbers, Pixels
from ..kernels import render_channels, splat_arrays
from ..scene.gaussians import SH_C0, Gaussians
from ..scene.views import View
from .heat import LUMA, class_colors
from .pictures import INK, PAPER

UNCLASSED_CONTRAST = 0.35  # share of its own light that a Gaussian without class keeps, around a middle grey


def colored(gaussians: Gaussians, labels: Ids, count: int) -> Gaussians:
    """Return the scene in the colours of its classes, for any viewer; a dim grey where there is no class."""
    light = np.clip(0.5 + SH_C0 * gaussians.sh[:, 0].mean(1), 0, 1)
    rgb = np.repeat((0.5 + UNCLASSED_CONTRAST * (light - 0.5))[:, None], 3, axis=1).astype(np.float32)
    has_class = labels >= 0
    rgb[has_class] = class_colors(count)[labels[has_class]] / 255
    sh = ((rgb - 0.5) / SH_C0).astype(np.float32)[:, None]
    return replace(gaussians, sh=sh)


def class_picture(
    gaussians: Gaussians, view: View, photo: Pixels, labels: Ids, names: list[str], threads: int = 0
) -> OtherPixels:
    """Draw the photo in grey, tinted by the visible classes, with a legend of the scene's classes below it."""
    colors = class_colors(len(names)).astype(np.float32)
    values = np.zeros((len(gaussians), 4), np.float32)
    has_class = labels >= 0
    values[has_class, :3], values[has_class, 3] = colors[labels[has_class]], 1
    channels = render_channels(splat_arrays(gaussians), view, values, threads=threads).channels
    picture = tinted(photo, channels[..., :3], channels[..., 3])
    present = np.unique(labels[has_class])
    return np.concatenate([picture, legend(picture.shape[1], [names[i] for i in present], colors[present])])


def tinted(photo: Pixels, color: Float32[np.ndarray, "h w 3"], share: PixelNumbers) -> Pixels:
    """Put colour over the photo's grey; `color` must be weighted by `share` already."""
    grey = (photo @ LUMA)[..., None]
    covered = np.clip(share, 0, 1)[..., None]
    shade = 0.4 + 0.6 * grey / 255
    return np.clip(shade * color + (1 - covered) * (0.5 * grey + 90), 0, 255).astype(np.uint8)


def legend(width: int, names: list[str], colors: np.ndarray) -> OtherPixels:
    """Draw swatches and names in as many columns as fit."""
    size = max(12, width // 45)
    letters = ImageFont.load_default(size)
    longest = max([letters.getlength(name) for name in names], default=0)
    column = int(longest) + 3 * size
    across = max(1, width // max(column, 1))
    rows = -(-len(names) // across)
    sheet = Image.new("RGB", (width, size + rows * 2 * size), PAPER)
    draw = ImageDraw.Draw(sheet)
    for index, (name, color) in enumerate(zip(names, colors, strict=True)):
        x, y = index % across * column + size, index // across * 2 * size + size // 2
        draw.rectangle((x, y, x + size, y + size), fill=tuple(int(part) for part in color))
        draw.text((x + 1.5 * size, y), name, INK, font=letters)
    return np.asarray(sheet)
