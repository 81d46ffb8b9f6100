"""Codebooks on disk: safetensors with the encoder's identity, checked by their hash."""

import json
import os
from collections.abc import Mapping

import numpy as np

from ...errors import FormatError, InputError, MismatchError
from ...formats.embedding_record import encoder_from_json
from ...formats.faiss_index import is_faiss
from ...formats.json_files import parsed
from ...formats.tensors import check_tensors, map_tensors, write_tensors
from ...scene.encoders import identity_json
from .codebook import Codebook

CODEBOOK_FORMAT = "drsplat codebook 1"


def save_codebook(codebook: Codebook, path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Write a codebook to one safetensors file."""
    metadata = {
        "format": CODEBOOK_FORMAT,
        "hash": codebook.hash,
        "encoder": json.dumps(identity_json(codebook.encoder)),
    }
    write_tensors(path, codebook.tensors(), metadata, overwrite)


def load_codebook(path: str | os.PathLike[str]) -> Codebook:
    """Read what `save_codebook` wrote. Raises: FormatError: another kind of file or version, or damaged."""
    if is_faiss(path):
        raise FormatError(
            f"{path}: a FAISS index, which does not say which encoder made its embeddings: "
            "read it with drsplat.field.codes.official.read_codebook, which takes the encoder's name"
        )
    tensors, metadata = map_tensors(path)
    if metadata.get("format") != CODEBOOK_FORMAT:
        raise FormatError(f"{path}: expected '{CODEBOOK_FORMAT}', got {ascii(metadata.get('format'))[:60]}")
    try:
        identity = parsed(metadata.get("encoder", ""))
    except (ValueError, RecursionError):
        identity = None
    return codebook_from_tensors(tensors, identity, metadata.get("hash"), str(path))


def codebook_from_tensors(
    tensors: Mapping[str, np.ndarray], identity: object, expected_hash: object, where: str
) -> Codebook:
    """Return the codebook of a file's arrays and the JSON identity of its encoder, checked by its hash.

    Raises: FormatError: something is missing or ill-formed, or the hash differs.
    """
    encoder = encoder_from_json(identity, where)
    expected = {"centroids": ("float32", "L c d"), "coarse": ("float32", "C D")}
    check_tensors(tensors, {k: v for k, v in expected.items() if k != "coarse" or k in tensors}, where)
    try:
        codebook = Codebook(tensors["centroids"], tensors.get("coarse"), encoder)
    except (InputError, MismatchError) as error:
        raise FormatError(f"{where}: {error}") from error
    if codebook.hash != expected_hash:
        raise FormatError(f"{where}: the codebook is not the one that was written (hash {codebook.hash})")
    return codebook
