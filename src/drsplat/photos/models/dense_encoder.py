"""Masks embedded by the patches that they cover: one pass over a photo, without cutting masks out."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...base.arrays import Embeddings, Float32, Pixels
from ...scene.masks.masks import Masks
from .devices import fitting
from .torch_encoder import as_rows
from .transformers_encoders import TransformersEncoder


class DensePatchEncoder(TransformersEncoder):
    """A model whose patches lie in the space of its texts, such as TIPSv2.

    The vector of a mask is the mean of the unit vectors of the patches, each weighted by how much of it the mask
    covers: its cosine with a text is proportional to the mean cosine of these patches. An image is a mask of all of it.
    """

    def __init__(self, name: str, folder: Path, device: str = "auto", dtype: str = "auto") -> None:
        super().__init__(name, folder, device, dtype)
        self._num_prefix_tokens = 1 + self._vision.num_register_tokens  # no patches

    def encode_masks(self, image: Pixels, masks: Masks) -> Embeddings:
        """Return unit vectors of the masks of an image, each with a pixel or more, in their order.

        Raises: FormatError: a vector without direction. DrSplatError: the image does not fit into memory.
        """
        with import_module("torch").inference_mode():
            ((patches,),) = fitting(lambda images: self._patch_rows(self._scaled(images)), [image], "photos")
        along = self.preprocessing.side // self._vision.patch_size
        shares = [coverage(masks, row, along) for row in range(len(masks))]
        return self._unit([share.reshape(1, -1) @ patches for share in shares], "mask")

    def _features(self, values: Any) -> np.ndarray:
        return self._patch_rows(values).mean(1)

    def _patch_rows(self, values: Any) -> Float32[np.ndarray, "b p d"]:
        """Return unit vectors of the patches of scaled images, row by row."""
        tokens = self._model.get_image_features(pixel_values=values).last_hidden_state[:, self._num_prefix_tokens :]
        rows = as_rows(tokens)
        with np.errstate(invalid="ignore", divide="ignore"):  # _unit says what is wrong
            return np.asarray(rows / np.linalg.norm(rows, axis=2, keepdims=True), np.float32)


def coverage(masks: Masks, row: int, along: int) -> Float32[np.ndarray, "a a"]:
    """Return how much of each cell of a grid over the image a mask covers, 0 to 1."""
    mask = Image.fromarray(masks.full(row).astype(np.float32))
    shares = np.asarray(mask.resize((along, along), Image.Resampling.BOX), np.float32)
    if shares.any():
        return shares
    # Pillow's box leaves out a pixel whose middle is the border of two cells.
    return np.asarray(mask.resize((along, along), Image.Resampling.BILINEAR), np.float32)
