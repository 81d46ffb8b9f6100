"""Checksums of what is kept on disk: CRC-32, found wrong where a bit has changed. No proof against forgers.

In safetensors files they stand in the header's metadata, in JSON documents beside the other keys.
"""

import hashlib
import json
import zlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ..contents import open_file, pieces
from ..errors import FormatError

TENSORS, HEADER, DOCUMENT = "crc32", "crc32_header", "crc32"
LARGE, AT_ONCE = 1 << 22, 4  # bytes from which a thread is worth its start; threads


def hash_file(path: Path) -> str:
    """Of the content of a file: blake2b, 16 bytes, as hexadecimals."""
    with open_file(path) as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def with_checksums(header: Mapping[str, object], tensors: Mapping[str, np.ndarray]) -> dict[str, object]:
    """A safetensors header with the checksum of each tensor, and of the header itself, in its metadata."""
    metadata = {**_metadata(header), TENSORS: json.dumps(_sums(tensors))}
    metadata.pop(HEADER, None)
    whole = _of_json({**header, "__metadata__": metadata})
    return {**header, "__metadata__": {**metadata, HEADER: whole}}


def check_header(header: Mapping[str, object], where: str) -> None:
    """Raises: FormatError: a header that carries its checksum is not what was written."""
    metadata = _metadata(header)
    written = metadata.pop(HEADER, None)
    if written is not None and written != _of_json({**header, "__metadata__": metadata}):
        raise FormatError(f"{where}: damaged: its header is not what was written")


def check_checksums(
    tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str], where: str, required: bool = True
) -> None:
    """Compare each tensor of a file with its checksum. Files of older versions have none: not `required`.

    Raises: FormatError: another tensor than was written, or no checksums.
    """
    if TENSORS not in metadata and not required:
        return
    written = _written(metadata)
    if not isinstance(written, dict) or set(written) != set(tensors) or HEADER not in metadata:
        raise FormatError(f"{where}: damaged: expected the checksum of every tensor in its header")
    for name, value in _sums(tensors).items():
        if value != written[name]:
            raise FormatError(f"{where}: damaged: tensor {name!a} is not what was written")


def sealed(document: Mapping[str, object]) -> dict[str, object]:
    """A JSON document with its own checksum."""
    return {**document, DOCUMENT: _of_json(_unsealed(document))}


def check_seal(document: Mapping[str, object], where: str, required: bool = True, cure: str = "") -> None:
    """Compare a JSON document with its checksum; those of older versions have none: not `required`.

    Raises: FormatError: another document than was written, or no checksum.
    """
    if not required and DOCUMENT not in document:
        return
    if document.get(DOCUMENT) != _of_json(_unsealed(document)):
        raise FormatError(f"{where}: damaged or edited: it is not what was written. {cure}".strip())


def _unsealed(document: Mapping[str, object]) -> dict[str, object]:
    return {key: value for key, value in document.items() if key != DOCUMENT}


def _metadata(header: Mapping[str, object]) -> dict[str, object]:
    metadata = header.get("__metadata__", {})
    return dict(metadata) if isinstance(metadata, dict) else {}


def _written(metadata: Mapping[str, str]) -> object:
    try:
        return json.loads(metadata.get(TENSORS, ""))
    except (ValueError, RecursionError):
        return None


def _of_json(document: object) -> str:
    """Of what a document says, whatever its spaces and the order of its keys."""
    return _hex([json.dumps(document, sort_keys=True, separators=(",", ":")).encode()])


def _sums(tensors: Mapping[str, np.ndarray]) -> dict[str, str]:
    """The checksum of each, of large ones at the same time."""
    if max((array.nbytes for array in tensors.values()), default=0) < LARGE:
        return {name: _hex(pieces(array)) for name, array in tensors.items()}
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return dict(zip(tensors, pool.map(lambda array: _hex(pieces(array)), tensors.values()), strict=True))


def _hex(parts: Iterable[bytes | memoryview]) -> str:
    value = 0
    for part in parts:
        value = zlib.crc32(part, value)
    return f"{value:08x}"
