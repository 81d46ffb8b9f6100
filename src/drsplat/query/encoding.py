"""The encoder that turns words into queries of a field."""

from collections.abc import Callable, Sequence
from copy import copy
from pathlib import Path
from typing import Protocol, runtime_checkable
from warnings import warn

from ..errors import DrSplatWarning, InputError, MismatchError
from ..field import LanguageField
from ..formats.vocabulary import read_vocabulary
from ..photos.models.loading import load_encoder
from ..photos.models.mini import MiniEncoder
from ..photos.models.words import WordEncoder
from ..scene.encoders import Encoder, EncoderIdentity

ENOUGH_TEXTS = 100  # of a vocabulary (study_short_lists.py, docs/search.md)
Load = Callable[[str, str], Encoder]


@runtime_checkable
class Embedded(Protocol):
    """A field or a catalogue, embedded by one encoder."""

    @property
    def encoder(self) -> EncoderIdentity: ...

    def check_encoder(self, identity: EncoderIdentity) -> None: ...


def encoder_for(
    field: Embedded,
    vocabulary: str | None = None,
    encoder: str | None = None,
    device: str = "auto",
    load: Load = load_encoder,
) -> Encoder:
    """Return the encoder that turns words into queries of this field.

    load: makes an encoder of a name and a device; several fields can share its models.

    Warns: DrSplatWarning: a vocabulary of few texts, of a field that keeps no list of its own.
    Raises: InputError: a field of another encoder than the built-in one, and neither its name nor a
    vocabulary; or both. MismatchError: another encoder, or one of another dimension where the field
    does not say who made it.
    """
    if encoder is not None:
        if vocabulary is not None:
            raise InputError("an encoder and a vocabulary were given, and both embed the words: drop one")
        return _loaded_encoder(field, encoder, device, load)
    if vocabulary is not None:
        # JSON does not say who made it, and neither does a field registered without a name of it
        anonymous = Path(vocabulary).suffix == ".json" or field.encoder.name == "unknown"
        words = read_vocabulary(vocabulary, name=field.encoder.name if anonymous else None)
        if anonymous and words.identity.dim != field.encoder.dim:
            raise MismatchError(
                f"{vocabulary}: its vectors have {words.identity.dim} numbers, those of this field "
                f"{field.encoder.dim}: embed the texts with the encoder of the masks, '{field.encoder.name}'"
            )
        if isinstance(field, LanguageField) and (doubt := list_doubt(words.texts, field)):
            warn(f"{vocabulary}: {doubt}", DrSplatWarning, stacklevel=2)
        return words
    if field.encoder.matches(WordEncoder.identity):
        return WordEncoder()
    if field.encoder.name == MiniEncoder.name:
        return _loaded_encoder(field, MiniEncoder.name, device, load)
    raise InputError(
        f"the masks of this field were embedded by '{field.encoder.name}' ({field.encoder.dim}-d), so words must be "
        f"too: pass encoder=NAME (its folder, or its id on the Hugging Face hub), vocabulary=FILE (JSON {{text: "
        f"[numbers]}}) of texts embedded with it, or one query with vector=FILE.npy ({field.encoder.dim} numbers)"
    )


def _loaded_encoder(field: Embedded, name: str, device: str, load: Load) -> Encoder:
    """Load an encoder and check it against the field; a field without an encoder's name accepts any."""
    encoder = copy(load(name, device))
    if field.encoder.name == "unknown" and encoder.identity.dim == field.encoder.dim:
        encoder.identity = EncoderIdentity("unknown", field.encoder.dim)
    field.check_encoder(encoder.identity)
    return encoder


def list_doubt(texts: Sequence[str], field: LanguageField) -> str:
    """Return why answers are not to be relied on that only so many texts tell apart; "" of long or kept lists."""
    if len(texts) >= ENOUGH_TEXTS or field.contrast is not None:
        return ""
    return (
        f"only {len(texts)} texts tell what a word does not mean, so answers may take in other things: add names of "
        f"any things, {ENOUGH_TEXTS} texts or more (docs/search.md)"
    )


def source_of(field: Embedded, encoder: Encoder | Callable[[], Encoder] | None) -> Callable[[], Encoder]:
    """Return a function that makes the encoder: a given one, or, for None, the built-in one that the field names."""
    if encoder is None:
        return lambda: encoder_for(field)
    if isinstance(encoder, Encoder) and not isinstance(encoder, type):  # a class makes one
        return lambda: encoder
    return encoder  # type: ignore[return-value]
