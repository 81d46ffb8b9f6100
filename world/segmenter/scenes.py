"""Photos of made scenes with the thing that each pixel shows."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int64, UInt8
from PIL import Image


@dataclass(frozen=True, eq=False)
class Photo:
    """truth: id + 1 of what a pixel shows, 0 for nothing. is_object: by that number; the others are structures."""

    name: str
    image: UInt8[np.ndarray, "h w 3"]
    truth: Int64[np.ndarray, "h w"]
    is_object: Bool[np.ndarray, " k"]


def photos(scenes: Sequence[Path], each: int = 1) -> list[Photo]:
    """Every `each`-th photo of folders as `python -m world` writes them."""
    return [photo(scene, path) for scene in scenes for path in sorted(scene.glob("lerf_ovs/*/images/*.jpg"))[::each]]


def photo(scene: Path, path: Path) -> Photo:
    facts = json.loads((scene / "truth.json").read_text())
    objects = [thing["id"] + 1 for thing in facts["objects"]]
    count = 1 + max(objects + [thing["id"] + 1 for thing in facts["structures"]])
    is_object = np.zeros(count, bool)
    is_object[objects] = True
    with Image.open(scene / "ids" / f"{path.stem}.png") as ids, Image.open(path) as image:
        truth = np.asarray(ids).astype(np.int64)
        return Photo(f"{scene.name}/{path.stem}", np.asarray(image.convert("RGB")), truth, is_object)


def with_smaller(photos: Sequence[Photo]) -> list[Photo]:
    """Every third at half its size."""
    return [halved(photo) if i % 3 == 2 else photo for i, photo in enumerate(photos)]


def halved(photo: Photo) -> Photo:
    image = np.asarray(Image.fromarray(photo.image).reduce(2))
    return Photo(photo.name, image, photo.truth[::2, ::2], photo.is_object)
