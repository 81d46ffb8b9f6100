"""A segmenter and an encoder without weights: colours are things, and equal crops equal vectors.

python fake_models.py CAPTURE OUTPUT    embeds slowly, so that it can be killed
"""

import sys
import time
from collections.abc import Sequence

import numpy as np
from PIL import Image

from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.masks.masks import LEVELS, Masks, cut_masks

DIM = 16


class ColorSegmenter:
    """Pixels of one colour of eight are a mask, but black is none.

    `small` has them, `medium` their upper halves, `large` and `default` all of them but the darkest,
    and one mask without pixels.
    """

    def __init__(self, seconds: float = 0.0, **settings: object) -> None:
        self.identity = {"name": "colours", "settings": {"shades": 2, **settings}}
        self.seconds, self.asked = seconds, 0

    def segment(self, image: np.ndarray) -> dict[str, Masks]:
        self.asked += 1
        time.sleep(self.seconds)
        shades = (image > 127) @ np.array([1, 2, 4])
        full = [shades == shade for shade in range(1, 8) if (shades == shade).any()]
        upper = np.arange(len(image))[:, None] < len(image) / 2
        found = {"small": full, "medium": [mask & upper for mask in full], "large": full}
        found["default"] = [*full[1:], np.zeros(shades.shape, bool)]
        return {level: as_masks(found[level], shades.shape) for level in LEVELS}


class LargeSegmenter(ColorSegmenter):
    """Of one level."""

    def segment(self, image: np.ndarray) -> dict[str, Masks]:
        return {"large": super().segment(image)["large"]}


def as_masks(full: list[np.ndarray], shape: tuple[int, ...]) -> Masks:
    stacked = np.array(full, bool).reshape(len(full), *shape)
    return cut_masks(stacked, np.ones(len(full), np.float32))


class ThumbnailEncoder:
    """A fixed random projection of an 8x8 thumbnail; counts the crops that it is given."""

    def __init__(self, name: str = "thumbnails", dim: int = DIM) -> None:
        self.identity, self.asked = EncoderIdentity(name, dim, "w0"), 0
        self._projection = np.random.default_rng(0).standard_normal((193, dim))

    def encode_images(self, images: Sequence[np.ndarray]) -> np.ndarray:
        self.asked += len(images)
        rows = np.stack([thumbnail(image) for image in images]) @ self._projection
        return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def thumbnail(image: np.ndarray) -> np.ndarray:
    """And a constant, so that black has a direction too."""
    small = Image.fromarray(image).resize((8, 8), Image.Resampling.BOX)
    return np.append(np.asarray(small, float).ravel() / 255, 0.1)


if __name__ == "__main__":
    from drsplat import read_views
    from drsplat.photos.embedding.embed import embed

    capture, output, form = sys.argv[1:]
    embed(read_views(capture), output, ColorSegmenter(seconds=0.1), ThumbnailEncoder(), form=form)
