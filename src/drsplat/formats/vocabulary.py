"""A file of words and their embeddings as an encoder: queries without a text model."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..base.arrays import Array, Embeddings
from ..errors import FormatError, InputError, did_you_mean
from ..scene.encoders import EncoderIdentity
from .json_files import as_kind, as_vector, document_in, excerpt, is_text, read_json
from .sog import is_sog_meta
from .tensors import check_checksums, map_tensors, write_tensors

TENSOR = "embeddings"


class VocabularyEncoder:
    """Encodes the texts it has in store and no other. Made by `read_vocabulary`.

    embeddings: one unit vector per text of `texts`.
    """

    def __init__(self, identity: EncoderIdentity, texts: Sequence[str], embeddings: Embeddings) -> None:
        self.identity, self.texts, self.embeddings = identity, tuple(texts), embeddings
        self._rows = {text.lower(): row for row, text in reversed(list(enumerate(self.texts)))}
        self._rows |= {text: row for row, text in enumerate(self.texts)}

    def encode_texts(self, texts: Sequence[str]) -> Embeddings:
        """Look the texts up, as they are or else as `spellings` of one that is there: "Mugs" is "mug".

        Raises: InputError: a text that is not in the vocabulary; the message has the closest ones.
        """
        if isinstance(texts, str):
            raise InputError(f"texts: expected a list of texts, got the single text {texts!r}")
        rows = [self._row(text) for text in texts]
        return self.embeddings[np.array(rows, np.intp)]

    def _row(self, text: str) -> int:
        known = next((one for one in (text, *spellings(text)) if one in self._rows), None)
        if known is not None:
            return self._rows[known]
        near = did_you_mean(text, self.texts) or f" It starts with {', '.join(map(repr, self.texts[:5]))}."
        raise InputError(
            f"{text!r} is not among the {len(self.texts)} texts of vocabulary '{self.identity.name}'.{near}"
        )


def spellings(text: str) -> tuple[str, ...]:
    """Return a text in small letters, without its article, and what it may be the plural of."""
    whole = text.lower().strip()
    word = next((whole.removeprefix(one) for one in ("a ", "an ", "the ") if whole.startswith(one)), whole)
    return (whole, word, *((word[:-1], word[:-2], f"{word[:-3]}y") if word.endswith("s") else ()))


def read_vocabulary(path: str | Path, name: str | None = None) -> VocabularyEncoder:
    """Read the vocabulary in a .json or .safetensors file; vectors are brought to unit length.

    JSON: {text: [numbers, ...]}, as OpenGaussian's text_features.json. Safetensors: a tensor
    "embeddings" (T, D) and metadata "texts" (a JSON list), "name", "weights"; see
    `write_vocabulary`.
    name: of the encoder that made the vectors, which fields made with that encoder check; default:
    the file's own, else the file's name without suffix.

    Raises: InputError: there is no such file. FormatError: it is damaged, vectors differ in length,
    a vector has no direction.

    >>> ds.read_vocabulary("clip_texts.json").texts[0]
    'red mug'
    """
    path = Path(path)
    if path.suffix == ".safetensors":
        texts, vectors, stored = _read_safetensors(path)
    else:
        texts, vectors, stored = *_read_json(path), {}
    identity = EncoderIdentity(name or stored.get("name") or path.stem, vectors.shape[1], stored.get("weights", ""))
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        wide = vectors.astype(np.float64)
        norms = np.sqrt((wide**2).sum(1))
    bad = np.flatnonzero(~(np.isfinite(norms) & (norms > 0)))
    if len(bad):
        raise FormatError(f"{path}: the vector of {excerpt(texts[bad[0]])} has no direction (zero or not finite)")
    unit: Array = (wide / norms[:, None]).astype(np.float32)
    return VocabularyEncoder(identity, texts, unit)


def write_vocabulary(path: str | Path, encoder: VocabularyEncoder, overwrite: bool = False) -> None:
    """Write a vocabulary as safetensors, with the identity of its encoder.

    Raises: InputError: the file exists and `overwrite` is false, or its folder does not.
    """
    identity = encoder.identity
    metadata = {"texts": json.dumps(encoder.texts), "name": identity.name, "weights": identity.weights}
    write_tensors(path, {TENSOR: encoder.embeddings}, metadata, overwrite)


def _read_json(path: Path) -> tuple[list[str], Array]:
    document = read_json(path)
    if not isinstance(document, dict) or not document:
        raise FormatError(f"{path}: expected a JSON object {{text: [numbers, ...]}}, got {excerpt(document)}")
    if is_sog_meta(document):
        raise FormatError(
            f"{path}: this is the meta.json of an unpacked SOG, a scene, and no vocabulary: name it where "
            "the Gaussians are queried"
        )
    first = next(iter(document.values()))
    dim = len(first) if isinstance(first, list) else 0
    if dim < 1:
        raise FormatError(
            f"{path}: expected a vocabulary, a list of numbers for each text; the first has {excerpt(first)}"
        )
    vectors = [as_vector(value, dim, f"{path}: {excerpt(text)}") for text, value in document.items()]
    return list(document), np.stack(vectors)


def _read_safetensors(path: Path) -> tuple[list[str], Array, Mapping[str, str]]:
    tensors, metadata = map_tensors(path)
    vectors = tensors.get(TENSOR)
    if vectors is None or "texts" not in metadata:
        raise FormatError(f"{path}: expected a safetensors file with '{TENSOR}' and metadata 'texts'")
    check_checksums(tensors, metadata, str(path), required=False)
    texts = as_kind(document_in(metadata["texts"], f"{path}: texts"), list[str], f"{path}: texts")
    if not all(is_text(metadata.get(name, "")) for name in ("name", "weights")):
        raise FormatError(f"{path}: expected the encoder's name and weights as text in its metadata")
    if len(set(texts)) < len(texts):
        raise FormatError(f"{path}: texts: expected a list of different texts, got {excerpt(texts)}")
    if vectors.ndim != 2 or 0 in vectors.shape or vectors.dtype.kind != "f" or len(vectors) != len(texts):
        raise FormatError(f"{path}: expected floats ({len(texts)}, D), got {vectors.dtype} {vectors.shape}")
    return texts, vectors, metadata
