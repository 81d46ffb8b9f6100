"""Image-text encoders: the identity of an embedding's encoder, and the interfaces for words and images."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ..base.arrays import Embeddings, OtherPixels
from ..errors import InputError


@dataclass(frozen=True)
class EncoderIdentity:
    """Identity of an encoder: embeddings can be compared only if their identities match.

    name: for people, e.g. "ViT-B-16/laion2b_s34b_b88k". dim: D. weights: hash of the weights, or "" if unknown.
    preprocessing: how images are scaled and normalised, or "" if unknown, as with files of LangSplat.

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
        """Return whether two identities agree in all that both know.

        Names count where a hash is missing: a model keeps its weights when its folder gets another name.
        """
        same_model = self.weights == other.weights if self.weights and other.weights else self.name == other.name
        both = {self.preprocessing, other.preprocessing} - {""}
        return same_model and self.dim == other.dim and len(both) <= 1


def identity_json(identity: EncoderIdentity) -> dict[str, object]:
    """Return the JSON object of files; without preprocessing if unknown, as in older files."""
    preprocessing = {"preprocessing": identity.preprocessing} if identity.preprocessing else {}
    return {"name": identity.name, "dim": identity.dim, "weights": identity.weights, **preprocessing}


def identity_text(encoder: EncoderIdentity) -> str:
    """Describe an encoder for people."""
    weights = f", weights {encoder.weights[:12]}" if encoder.weights else ""
    images = f", images at {encoder.preprocessing}" if encoder.preprocessing else ""
    return f"{encoder.name} ({encoder.dim}-d{weights}{images})"


@runtime_checkable
class Encoder(Protocol):
    """Encoder of words to unit vectors in the space of the scene's embeddings."""

    identity: EncoderIdentity

    def encode_texts(self, texts: Sequence[str]) -> Embeddings: ...


@runtime_checkable
class ImageEncoder(Protocol):
    """Encoder of images to unit vectors in the space of the scene's embeddings.

    It scales and normalises images itself: both belong to its weights.
    """

    identity: EncoderIdentity

    def encode_images(self, images: Sequence[OtherPixels]) -> Embeddings: ...
