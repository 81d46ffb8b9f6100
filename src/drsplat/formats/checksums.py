"""Checksums of what is kept on disk: CRC-32, found wrong where a bit has changed. No proof against forgers.

In safetensors files they stand in the header's metadata, in JSON documents beside the other keys.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from .. import _native
from ..base.arrays import ArraysByName
from ..base.contents import open_file, pieces
from ..errors import FormatError
from .json_files import document_in

TENSORS, HEADER, DOCUMENT, ROWS = "crc32", "crc32_header", "crc32", "crc32_rows"
MIN_THREADED_BYTES = 1 << 22  # of an array whose checksum is worth a thread's start
MAX_THREADS = 4
READ_BYTES = 1 << 20
JSON_INDENTS = (1, 2)  # those that we write documents with


def hash_file(path: Path) -> str:
    """Return the checksum of a file's content: blake2b, 16 bytes, in hexadecimal."""
    with open_file(path) as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def file_checksum(path: Path) -> str:
    """Return the checksum of a file's content, read a piece at a time."""
    with open_file(path) as file:
        return _hex(iter(partial(file.read, READ_BYTES), b""))


def with_checksums(header: Mapping[str, object], tensors: ArraysByName) -> dict[str, object]:
    """Return a safetensors header with the checksum of each tensor, and of the header itself, in its metadata."""
    metadata = {**_metadata(header), TENSORS: json.dumps(_sums(tensors))}
    metadata.pop(HEADER, None)
    whole = _of_json({**header, "__metadata__": metadata})
    return {**header, "__metadata__": {**metadata, HEADER: whole}}


def header_checksum(metadata: object) -> str:
    """Return the checksum of the header that carries this metadata; "" where it has none."""
    return str(metadata.get(HEADER, "")) if isinstance(metadata, Mapping) else ""


def check_header(header: Mapping[str, object], where: str) -> None:
    """Check a header. Raises: FormatError: it carries a checksum and is not what was written."""
    metadata = _metadata(header)
    written = metadata.pop(HEADER, None)
    if written is not None and written != _of_json({**header, "__metadata__": metadata}):
        raise FormatError(f"{where}: damaged: its header is not what was written")


def check_checksums(
    tensors: ArraysByName,
    metadata: Mapping[str, str],
    where: str,
    required: bool = True,
    names: Collection[str] | None = None,
) -> None:
    """Compare each tensor of a file with its checksum. Files of older versions have none: not `required`.

    names: the tensors to compare; None: all.

    Raises: FormatError: another tensor than was written, or no checksums.
    """
    if TENSORS not in metadata and not required:
        return
    written = _written(metadata)
    if not isinstance(written, dict) or set(written) != set(tensors) or HEADER not in metadata:
        raise FormatError(f"{where}: damaged: expected the checksum of every tensor in its header")
    compared = {name: value for name, value in tensors.items() if names is None or name in names}
    for name, value in _sums(compared).items():
        if value != written[name]:
            raise FormatError(f"{where}: damaged: tensor {name!a} is not what was written")


def row_checksums(tensors: ArraysByName) -> dict[str, str]:
    """Return metadata with the checksum of each row of some tensors, for files of which few rows are read at a time."""
    return {ROWS: json.dumps({name: [_hex(pieces(row)) for row in array] for name, array in tensors.items()})}


def written_rows(tensors: ArraysByName, metadata: Mapping[str, str], where: str) -> dict[str, list[str]] | None:
    """Return the checksums of `row_checksums` by tensor; None in files of older versions, which have none.

    Raises: FormatError: not a checksum for every row.
    """
    if ROWS not in metadata:
        return None
    written = _written(metadata, ROWS)
    if not isinstance(written, dict) or written.keys() != tensors.keys():
        raise FormatError(f"{where}: damaged: expected the checksums of every row")
    for name, sums in written.items():
        if not isinstance(sums, list) or len(sums) != len(tensors[name]):
            raise FormatError(f"{where}: damaged: expected a checksum for each row of {name!a}")
    return written


def check_row(row: np.ndarray, sums: Sequence[str], number: int, where: str) -> None:
    """Compare one row with its checksum. Raises: FormatError: another row than was written."""
    if _hex(pieces(row)) != sums[number]:
        raise FormatError(f"{where}: damaged: row {number} is not what was written")


def sealed(document: Mapping[str, object]) -> dict[str, object]:
    """Return a JSON document with its own checksum."""
    return {**document, DOCUMENT: _of_json(_unsealed(document))}


def check_seal(document: Mapping[str, object], where: str, required: bool = True, cure: str = "") -> None:
    """Compare a JSON document with its checksum; those of older versions have none: not `required`.

    Raises: FormatError: another document than was written, or no checksum.
    """
    if not required and DOCUMENT not in document:
        return
    if document.get(DOCUMENT) != _of_json(_unsealed(document)):
        raise FormatError(f"{where}: damaged or edited: it is not what was written. {cure}".strip())


def check_document(path: Path) -> None:
    """Compare every byte of a sealed JSON document of ours; `check_seal` passes over spaces and the order of keys.

    Raises: FormatError: another document than was written, or one that something else has written anew.
    """
    with open_file(path) as file:
        content = file.read()
    document = document_in(content, str(path))
    check_seal(document if isinstance(document, dict) else {}, str(path))
    if content.removesuffix(b"\n") not in {json.dumps(document, indent=indent).encode() for indent in JSON_INDENTS}:
        raise FormatError(f"{path}: damaged or edited: it is not what was written")


def _unsealed(document: Mapping[str, object]) -> dict[str, object]:
    return {key: value for key, value in document.items() if key != DOCUMENT}


def _metadata(header: Mapping[str, object]) -> dict[str, object]:
    metadata = header.get("__metadata__", {})
    return dict(metadata) if isinstance(metadata, dict) else {}


def _written(metadata: Mapping[str, str], key: str = TENSORS) -> object:
    try:
        return json.loads(metadata.get(key, ""))
    except (ValueError, RecursionError):
        return None


def _of_json(document: object) -> str:
    """Return the checksum of a document's values, whatever its spaces and the order of its keys."""
    return _hex([json.dumps(document, sort_keys=True, separators=(",", ":")).encode()])


def _sums(tensors: ArraysByName) -> dict[str, str]:
    """Return the checksum of each tensor; large ones are hashed in parallel."""
    if max((array.nbytes for array in tensors.values()), default=0) < MIN_THREADED_BYTES:
        return {name: _hex(pieces(array)) for name, array in tensors.items()}
    with ThreadPoolExecutor(MAX_THREADS) as pool:
        return dict(zip(tensors, pool.map(lambda array: _hex(pieces(array)), tensors.values()), strict=True))


def _hex(parts: Iterable[bytes | memoryview]) -> str:
    value = 0
    for part in parts:
        value = _native.crc32(part, value)
    return f"{value:08x}"
