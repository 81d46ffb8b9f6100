"""Masks of one photo and their embeddings."""

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Embeddings, MaskIds
from ...base.terminal import counted
from ...errors import InputError

UNIT_TOLERANCE = 1e-3  # of an embedding's norm


@dataclass(frozen=True, eq=False)
class ViewFeatures:
    """Masks of one view and their embeddings.

    mask_ids: for each pixel the mask that covers it, as a row of `embeddings`, or -1.
    embeddings: a unit vector for each mask.

    Raises: InputError: a mask id without an embedding, a row that is not a finite unit vector.
    """

    mask_ids: MaskIds
    embeddings: Embeddings

    def __post_init__(self) -> None:
        if self.mask_ids.ndim != 2 or self.mask_ids.dtype != np.int32:
            raise InputError(f"mask_ids: expected int32 (H, W), got {self.mask_ids.dtype} {self.mask_ids.shape}")
        if self.embeddings.ndim != 2 or self.embeddings.dtype != np.float32:
            raise InputError(
                f"embeddings: expected float32 (S, D), got {self.embeddings.dtype} {self.embeddings.shape}"
            )
        largest = int(self.mask_ids.max(initial=-1))
        if largest >= len(self.embeddings):
            raise InputError(f"mask id {largest} has no embedding: there are {len(self.embeddings)}")
        norms = np.linalg.norm(self.embeddings, axis=1)
        if not (np.abs(norms - 1) < UNIT_TOLERANCE).all():
            raise InputError("embeddings must be finite unit vectors: divide each row by its L2 norm")

    def __repr__(self) -> str:
        (count, dim), (height, width) = self.embeddings.shape, self.mask_ids.shape
        return f"{type(self).__name__}({counted(count, 'mask')} on {width}x{height}, {dim}-d)"

    def resized(self, width: int, height: int) -> "ViewFeatures":
        """Return the features with the map resampled to another raster, by the nearest pixel centre."""
        h, w = self.mask_ids.shape
        if (w, h) == (width, height):
            return self
        rows = ((np.arange(height) + 0.5) * h / height).astype(np.intp)
        columns = ((np.arange(width) + 0.5) * w / width).astype(np.intp)
        return ViewFeatures(self.mask_ids.take(columns, 1).take(rows, 0), self.embeddings)
