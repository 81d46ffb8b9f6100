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
from ...formats.json_files import as_count, as_number, as_object, as_vector, excerpt, read_json

Triple = tuple[float, ...]
Colors = tuple[Triple, Triple]
"""Mean and standard deviation per channel, of values from 0 to 1."""
HALF: Colors = (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)
OPENAI: Colors = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
IMAGENET: Colors = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


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
        size = [self.side if self.stretch else length * self.side // min(height, width) for length in (width, height)]
        left, top = ((length - self.side) // 2 for length in size)
        picture = Image.fromarray(np.ascontiguousarray(image)).resize(size, Image.Resampling[self.filter.upper()])
        pixels = np.asarray(picture.crop((left, top, left + self.side, top + self.side)))
        # the value of each byte in each channel, rounded once
        levels = ((np.arange(256)[:, None] * self.scale - self.mean) / self.std).astype(np.float32)
        return np.stack([levels[:, channel].take(pixels[..., channel]) for channel in range(3)])


def read_preprocessing(folder: Path, default: Preprocessing) -> Preprocessing:
    """Read the preprocessing of a model's folder; the default if the folder has no file of it.

    A square image is scaled to what the model sees and never cut: a processor that scales to more and
    cuts (DINOv2: 256, then 224) would lose the ends of masks, which reach the edges of their crops.

    Raises: FormatError: the file is damaged, or asks for what we do not do.
    """
    path, settings = processor_settings(folder)
    return preprocessing_of(settings, path, default)


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
    resample = settings.get("resample", default.filter)
    if not isinstance(resample, str):
        number = as_count(resample, f"{path}: resample")
        if number not in list(Image.Resampling):
            raise FormatError(f"{path}: resample: Pillow has no filter {number}")
        resample = Image.Resampling(number).name.lower()
    return Preprocessing(
        _side(size, f"{path}: size"),
        resample,
        *colors_of(settings, path, (default.mean, default.std)),
        as_number(settings.get("rescale_factor", default.scale), f"{path}: rescale_factor"),
        stretch=not cut and not (isinstance(size, dict) and "shortest_edge" in size),
    )


def processor_settings(folder: Path) -> tuple[Path, dict[str, Any]]:
    """Return the file that says how a model's images are prepared, and its settings; none without such a file.

    Raises: FormatError: the file is damaged.
    """
    for name, key in (("preprocessor_config.json", None), ("processor_config.json", "image_processor")):
        path = folder / name
        settings = read_json(path) if path.is_file() else None
        if key and isinstance(settings, dict):
            settings = settings.get(key)
        if settings is not None:
            return path, {name: value for name, value in as_object(settings, str(path)).items() if value is not None}
    return folder, {}


def colors_of(settings: dict[str, Any], path: Path, default: Colors) -> Colors:
    """Return the mean and the deviation of each channel.

    Raises: FormatError: other than three numbers, or deviations that are not positive.
    """
    mean, std = (
        as_vector(settings.get(name, list(usual)), 3, f"{path}: {name}").tolist()
        for name, usual in zip(("image_mean", "image_std"), default, strict=True)
    )
    if min(std) <= 0:
        raise FormatError(f"{path}: image_std: expected positive numbers, got {std}")
    return tuple(mean), tuple(std)


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
