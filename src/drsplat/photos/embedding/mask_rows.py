"""Embeddings of an image's masks: of their crops, or of the patches that they cover, as the encoder needs."""

from typing import Protocol, runtime_checkable

import numpy as np

from ...base.arrays import Float32, UInt8
from ...scene.encoders import ImageEncoder
from ...scene.masks.crops import crops
from ...scene.masks.masks import Masks


@runtime_checkable
class MaskEncoder(Protocol):
    """Encoder that embeds masks from one pass over the image, without crops of them."""

    def encode_masks(self, image: UInt8[np.ndarray, "h w 3"], masks: Masks) -> Float32[np.ndarray, "n d"]: ...


def mask_rows(image: UInt8[np.ndarray, "h w 3"], masks: Masks, encoder: ImageEncoder) -> Float32[np.ndarray, "n d"]:
    """Return unit vectors of the masks of an image, each with a pixel or more, in their order."""
    if isinstance(encoder, MaskEncoder):
        return encoder.encode_masks(image, masks)
    return encoder.encode_images(crops(image, masks))
