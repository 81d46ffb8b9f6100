"""Image-text encoders: who made an embedding, and how to make a query from words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, UInt8


@dataclass(frozen=True)
class EncoderIdentity:
    """Two embeddings can be compared only if their identities are equal.

    name: for people, e.g. "ViT-B-16/laion2b_s34b_b88k". dim: D. weights: hash of the weights, or ""
    where it is not known (then only name and dim are compared).
    """

    name: str
    dim: int
    weights: str = ""

    def matches(self, other: "EncoderIdentity") -> bool:
        same_weights = not (self.weights and other.weights) or self.weights == other.weights
        return (self.name, self.dim) == (other.name, other.dim) and same_weights


@runtime_checkable
class Encoder(Protocol):
    """Words to unit vectors in the space of the scene's embeddings."""

    identity: EncoderIdentity

    def encode_texts(self, texts: Sequence[str]) -> Float32[np.ndarray, "t d"]: ...


@runtime_checkable
class ImageEncoder(Protocol):
    """Images to unit vectors in the space of the scene's embeddings.

    Scaling and normalisation are the encoder's own: they belong to its weights.
    """

    identity: EncoderIdentity

    def encode_images(
        self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]
    ) -> Float32[np.ndarray, "n d"]: ...
