"""Image-text encoders: who made an embedding, and how to make a query from words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from .arrays import Float32, UInt8
from .errors import InputError


@dataclass(frozen=True)
class EncoderIdentity:
    """Two embeddings can be compared only if their identities match.

    name: for people, e.g. "ViT-B-16/laion2b_s34b_b88k". dim: D. weights: hash of the weights, or "" where it is not
    known. preprocessing: how images are scaled and normalised, or "" where it is not known, as with files of LangSplat.

    Raises: InputError: a text with half of a surrogate pair, which JSON can hold and no other file or answer.
    """

    name: str
    dim: int
    weights: str = ""
    preprocessing: str = ""

    def __post_init__(self) -> None:
        for text in (self.name, self.weights, self.preprocessing):
            if any(0xD800 <= ord(letter) < 0xE000 for letter in text):
                raise InputError(f"encoder: expected a name that can be written, got {ascii(text)[:80]}")

    def matches(self, other: "EncoderIdentity") -> bool:
        """Equal in all that both know. Names count where a hash is missing: a model keeps its
        weights when its folder gets another name."""
        same_model = self.weights == other.weights if self.weights and other.weights else self.name == other.name
        return same_model and self.dim == other.dim and _agree(self.preprocessing, other.preprocessing)


def _agree(one: str, other: str) -> bool:
    return not (one and other) or one == other


def identity_json(identity: EncoderIdentity) -> dict[str, object]:
    """As files have it; without preprocessing where it is not known, as files had it before."""
    known = {"preprocessing": identity.preprocessing} if identity.preprocessing else {}
    return {"name": identity.name, "dim": identity.dim, "weights": identity.weights, **known}


def identity_said(encoder: EncoderIdentity) -> str:
    """For people."""
    weights = f", weights {encoder.weights[:12]}" if encoder.weights else ""
    images = f", images at {encoder.preprocessing}" if encoder.preprocessing else ""
    return f"{encoder.name} ({encoder.dim}-d{weights}{images})"


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

    def encode_images(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> Float32[np.ndarray, "n d"]: ...
