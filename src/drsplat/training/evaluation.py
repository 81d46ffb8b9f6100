"""Held-out photos against renderings from their places: numbers and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.arrays import Image, UInt8
from ..drawing.pictures import as_pixels, write_picture
from ..kernels.training import SceneParameters, forward
from ..scene.gaussians import PUBLISHED_NEAR
from ..scene.views import View
from .metrics import psnr, ssim
from .settings import TrainingSettings
from .training_photos import Photo, TrainingPhotos

ERROR_GAIN = 4.0


@dataclass(frozen=True)
class ViewScore:
    """psnr in dB; both over the pixels that the photo covers and its mask, where it has one, keeps."""

    name: str
    psnr: float
    ssim: float


@dataclass(frozen=True)
class Evaluation:
    """Means over the held-out views, and each of them."""

    psnr: float
    ssim: float
    views: tuple[ViewScore, ...]


def evaluate(
    parameters: SceneParameters,
    views: Sequence[View],
    photos: TrainingPhotos,
    settings: TrainingSettings,
    *,
    near: float = PUBLISHED_NEAR,
    pictures: Path | None = None,
    threads: int = 0,
) -> Evaluation | None:
    """Render each view, clipped to [0, 1], and compare; None when nothing is held out.

    near: camera z up to which nothing is drawn. pictures: folder for a PNG per view: photo, rendering, and their
    difference times 4.
    """
    if not views:
        return None
    scores = []
    for index, view in enumerate(views):
        image = rendered(parameters, view, settings, near, threads)
        photo = photos[index]
        scores.append(_score(view.name, image, photo))
        if pictures is not None:
            path = pictures / Path(view.name).with_suffix(".png")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_picture(path, side_by_side(image, photo), overwrite=True)
    return Evaluation(
        float(np.mean([score.psnr for score in scores])),
        float(np.mean([score.ssim for score in scores])),
        tuple(scores),
    )


def rendered(
    parameters: SceneParameters, view: View, settings: TrainingSettings, near: float = PUBLISHED_NEAR, threads: int = 0
) -> Image:
    """Render a picture with all SH degrees on the settings' backdrop, clipped to [0, 1]."""
    backdrop = np.array(settings.backdrop, np.float32)
    drawn = forward(
        parameters, view, settings.sh_degree, backdrop, near=near, antialiased=settings.antialiased, threads=threads
    )
    return np.clip(drawn.image, 0, 1)


def _score(name: str, image: Image, photo: Photo) -> ViewScore:
    """Compare a rendering with its photo, without what a mask leaves out, also in the windows of SSIM beside it."""
    colors = photo.colors()
    if photo.left_out is not None:
        colors[photo.left_out] = image[photo.left_out]
    unused = photo.unused
    return ViewScore(name, psnr(image, colors, unused), ssim(image, colors, unused))


def side_by_side(image: Image, photo: Photo) -> UInt8[np.ndarray, "h w3 3"]:
    """Draw photo, rendering, and four times their difference."""
    error = np.abs(image - photo.colors()) * np.float32(ERROR_GAIN)
    if photo.unused is not None:
        error[photo.unused] = 0
    return np.concatenate([photo.pixels, as_pixels(image), as_pixels(error)], axis=1)
