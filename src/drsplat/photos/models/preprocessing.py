"""Preprocessing: the pixels of an image to the numbers that a model was trained on.

drsplat uses Pillow alone: the processors of transformers differ from each other, with and without torchvision, and
their embeddings could not be compared.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...base.arrays import Float32, OtherPixels
from ...errors import FormatError, InputError
from ...formats.json_files import as_count, as_number, as_vector, excerpt, read_json

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Preprocessing:
    """Preprocessing of images for a model.

    side: pixels of the square that the model sees. filter: Pillow's name. mean, std: per channel, of scaled values.
    scale: of a byte. stretch: stretch other images to the square; else the shorter side becomes `side` and the middle
    is cut out.
    """

    side: int
    filter: str
    mean: Triple
    std: Triple
    scale: float = 1 / 255
    stretch: bool = False

    def __str__(self) -> str:
        """Return all settings that decide the numbers, in short: part of an encoder's identity."""
        mean, std = (" ".join(f"{x:.6g}" for x in triple) for triple in (self.mean, self.std))
        fit = "stretched" if self.stretch else "cut"
        return f"{self.side} px {self.filter} {fit}, x{self.scale:.6g}, mean {mean}, std {std}"

    def pixel_values(self, image: OtherPixels) -> Float32[np.ndarray, "3 s s"]:
        """Return the model's input for an image. Raises: InputError: an image without pixels."""
        height, width = image.shape[:2]
        if min(height, width) < 1:
            raise InputError(f"an image of {width}x{height} pixels: expected at least one pixel")
        pixels = np.asarray(self._square(Image.fromarray(np.ascontiguousarray(image))))
        return np.stack([self._levels(c).take(pixels[..., c]) for c in range(3)])

    def _square(self, picture: Image.Image) -> Image.Image:
        width, height = picture.size
        if self.stretch or width == height:
            size = (self.side, self.side)
        else:
            shorter = min(width, height)
            size = (width * self.side // shorter, height * self.side // shorter)
        scaled = picture.resize(size, Image.Resampling[self.filter.upper()])
        left, top = (size[0] - self.side) // 2, (size[1] - self.side) // 2
        return scaled.crop((left, top, left + self.side, top + self.side))

    def _levels(self, channel: int) -> Float32[np.ndarray, "256"]:
        """Return the value of each byte, rounded once."""
        scaled = np.arange(256) * self.scale - self.mean[channel]
        return np.asarray(scaled / self.std[channel], np.float32)


def read_preprocessing(folder: Path, default: Preprocessing) -> Preprocessing:
    """Read the preprocessing of a model's folder; the default if the folder has no file of it.

    A square image is scaled to what the model sees and never cut: a processor that scales to more and
    cuts (DINOv2: 256, then 224) would lose the ends of masks, which reach the edges of their crops.

    Raises: FormatError: the file is damaged, or asks for what we do not do.
    """
    path, settings = _settings(folder)
    return default if settings is None else preprocessing_of(settings, path, default)


def preprocessing_of(settings: dict[str, Any], path: Path, default: Preprocessing) -> Preprocessing:
    """Return the preprocessing from settings of a processor of transformers, read from `path`.

    Raises: as `read_preprocessing`.
    """
    for step in ("do_resize", "do_rescale"):
        if settings.get(step, True) is not True:
            raise FormatError(f"{path}: {step} is off; drsplat always resizes and scales")
    if settings.get("do_normalize", True) is False:
        settings = {**settings, "image_mean": [0, 0, 0], "image_std": [1, 1, 1]}
    cut = settings.get("do_center_crop", not default.stretch)
    size = settings.get("crop_size" if cut and "crop_size" in settings else "size", default.side)
    return Preprocessing(
        _side(size, f"{path}: size"),
        _filter(settings.get("resample", default.filter), str(path)),
        _triple(settings.get("image_mean", list(default.mean)), f"{path}: image_mean"),
        _triple(settings.get("image_std", list(default.std)), f"{path}: image_std"),
        as_number(settings.get("rescale_factor", default.scale), f"{path}: rescale_factor"),
        stretch=not cut and not (isinstance(size, dict) and "shortest_edge" in size),
    )


def _settings(folder: Path) -> tuple[Path, dict[str, Any] | None]:
    for name, key in (("preprocessor_config.json", None), ("processor_config.json", "image_processor")):
        path = folder / name
        if not path.is_file():
            continue
        document = read_json(path)
        settings = document.get(key) if key and isinstance(document, dict) else document
        if key and settings is None:
            continue
        if not isinstance(settings, dict):
            raise FormatError(f"{path}: expected an object, got {excerpt(settings)}")
        return path, {name: value for name, value in settings.items() if value is not None}
    return folder, None


def _side(size: object, where: str) -> int:
    """Return the side from 224, {"shortest_edge": 224} or {"height": 224, "width": 224}."""
    if isinstance(size, dict):
        sides = {as_count(size[key], where) for key in ("shortest_edge", "height", "width") if size.get(key)}
        if len(sides) != 1:
            raise FormatError(f"{where}: expected one side of a square, got {excerpt(str(size))}")
        size = sides.pop()
    side = as_count(size, where)
    if not 1 <= side <= 4096:
        raise FormatError(f"{where}: expected 1 to 4096 pixels, got {side}")
    return side


def _filter(resample: object, where: str) -> str:
    if isinstance(resample, str):
        return resample
    number = as_count(resample, f"{where}: resample")
    if number not in list(Image.Resampling):
        raise FormatError(f"{where}: resample: Pillow has no filter {number}")
    return Image.Resampling(number).name.lower()


def _triple(value: object, where: str) -> Triple:
    red, green, blue = as_vector(value, 3, where).tolist()
    if where.endswith("std") and min(red, green, blue) <= 0:
        raise FormatError(f"{where}: expected positive numbers, got {excerpt(str(value))}")
    return red, green, blue
