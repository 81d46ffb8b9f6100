"""Masks as a segmenter would draw them, and their embeddings as an encoder of words would give them.

The exact label of a pixel is the thing with the largest blending weight there. A real segmenter does
worse, and so do these masks: borders are left out, small and some other masks are missing, and a thing
that is seen in two pieces has two masks.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Int32
from scipy import ndimage

from drsplat.base.arrays import MaskIds
from drsplat.kernels import SplatArrays, render_channels, splat_arrays
from drsplat.scene.encoders import Encoder
from drsplat.scene.masks.features import ViewFeatures
from drsplat.scene.views import View

from .room import Room

MISSED_SHARE = 0.08
MIN_PIXELS = 40
MIN_ALPHA = 0.5
NOISE = 0.5  # length of the noise on a unit embedding: masks of one thing are at cosine 1 / (1 + NOISE^2) = 0.8


@dataclass(frozen=True, eq=False)
class MaskMaker:
    """Makes the masks of one room, photo by photo; the same seed and photo give the same masks."""

    room: Room
    encoder: Encoder
    seed: int = 0

    @cached_property
    def _splats(self) -> SplatArrays:
        return splat_arrays(self.room.gaussians)

    def features(self, view: View) -> ViewFeatures:
        """MaskIds with noisy embeddings."""
        rng = np.random.default_rng([self.seed, *view.name.encode()])
        labels = exact_labels(self.room, view, splats=self._splats)
        mask_ids, things = perturbed(labels, rng)
        clean = self.encoder.encode_texts(self.room.names)[things]
        noise = rng.standard_normal(clean.shape)
        noisy = clean + NOISE * noise / np.linalg.norm(noise, axis=1, keepdims=True)
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        return ViewFeatures(mask_ids, noisy.astype(np.float32))


def exact_labels(room: Room, view: View, *, splats: SplatArrays | None = None) -> MaskIds:
    """Per pixel the thing of the largest blending weight; -1 where less than half is covered."""
    one_hot: Float32[np.ndarray, "n c"] = np.eye(len(room.names), dtype=np.float32)[room.labels]
    drawn = render_channels(splats or splat_arrays(room.gaussians), view, one_hot)
    return np.where(drawn.alpha < MIN_ALPHA, -1, drawn.channels.argmax(-1)).astype(np.int32)


def perturbed(labels: MaskIds, rng: np.random.Generator) -> tuple[MaskIds, Int32[np.ndarray, " s"]]:
    """Mask map with ids from 0, and the thing behind each mask."""
    mask_ids = np.full(labels.shape, -1, np.int32)
    things: list[int] = []
    inner = labels == ndimage.minimum_filter(labels, 3)
    inner &= labels == ndimage.maximum_filter(labels, 3)
    for label, window in enumerate(ndimage.find_objects(labels + 1)):
        pieces, num = ndimage.label(inner[window] & (labels[window] == label)) if window else (labels, 0)
        sizes = np.bincount(pieces.ravel(), minlength=num + 1) if num else np.zeros(1)
        for piece in np.flatnonzero(sizes[1:] >= MIN_PIXELS) + 1:
            if rng.random() >= MISSED_SHARE:
                mask_ids[window][pieces == piece] = len(things)
                things.append(label)
    return mask_ids, np.array(things, np.int32)
