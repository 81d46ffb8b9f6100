"""Safetensors files: written whole or not at all, large ones mapped, headers never trusted.

Source: the safetensors format (8 bytes little-endian header length, JSON header, tensor bytes).

Checksums of what is kept on disk: CRC-32, found wrong where a bit has changed. No proof against forgers.

In safetensors files they stand in the header's metadata, in JSON documents beside the other keys.
"""

import hashlib
import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import _native
from ..base.arrays import Array, Arrays, ArraysByName
from ..base.contents import AnyPath, file_bytes, open_file, pieces
from ..errors import FormatError, InputError
from .json_files import document_in, unique_names
from .replacing import replacing

TENSORS, HEADER, DOCUMENT, ROWS = "crc32", "crc32_header", "crc32", "crc32_rows"
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


def header_checksum(metadata: object) -> str:
    """Return the checksum of the header that carries this metadata; "" where it has none."""
    return str(metadata.get(HEADER, "")) if isinstance(metadata, Mapping) else ""


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


def written_rows(tensors: ArraysByName, metadata: Mapping[str, str], where: str) -> dict[str, list[str]]:
    """Return the checksums of `row_checksums` by tensor. Raises: FormatError: not a checksum for every row."""
    written = _written(metadata, ROWS)
    if not isinstance(written, dict) or written.keys() != tensors.keys():
        raise FormatError(f"{where}: damaged: expected the checksums of every row")
    for name, sums in written.items():
        if not isinstance(sums, list) or len(sums) != len(tensors[name]):
            raise FormatError(f"{where}: damaged: expected a checksum for each row of {name!a}")
    return written


def check_row(row: Array, sums: Sequence[str], number: int, where: str) -> None:
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


def _written(metadata: Mapping[str, str], key: str = TENSORS) -> object:
    try:
        return json.loads(metadata.get(key, ""))
    except (ValueError, RecursionError):
        return None


def _of_json(document: object) -> str:
    """Return the checksum of a document's values, whatever its spaces and the order of its keys."""
    return _hex([json.dumps(document, sort_keys=True, separators=(",", ":")).encode()])


def _sums(tensors: ArraysByName) -> dict[str, str]:
    """Return the checksum of each tensor; several gigabytes a second."""
    return {name: _hex(pieces(array)) for name, array in tensors.items()}


def _hex(parts: Iterable[bytes | memoryview]) -> str:
    value = 0
    for part in parts:
        value = _native.crc32(part, value)
    return f"{value:08x}"


_DTYPES = {
    "BOOL": np.dtype("?"), "U8": np.dtype("u1"), "I8": np.dtype("i1"),
    "U16": np.dtype("<u2"), "I16": np.dtype("<i2"), "F16": np.dtype("<f2"),
    "U32": np.dtype("<u4"), "I32": np.dtype("<i4"), "F32": np.dtype("<f4"),
    "U64": np.dtype("<u8"), "I64": np.dtype("<i8"), "F64": np.dtype("<f8"),
}  # fmt: skip
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}
_MAX_HEADER_BYTES = 64 << 20
CACHE_LINE_BYTES = 64


def write_tensors(
    path: AnyPath, tensors: ArraysByName, metadata: Mapping[str, str] | None = None, overwrite: bool = False
) -> str:
    """Write named arrays and text metadata, whole or not at all, with their checksums.

    Returns the checksum of the header, which has those of all arrays in it: other content has another one.

    Raises: InputError: a dtype that safetensors has no name for, or `path` exists and `overwrite` is false.
    """
    arrays = {name: np.asarray(array) for name, array in tensors.items()}
    for name, array in arrays.items():
        if array.dtype not in _NAMES:
            raise InputError(f"tensor '{name}': safetensors has no name for {array.dtype}")
    # Those of whole cache lines, which then begin at one, then the widest: so all are aligned to their items.
    order = sorted(
        arrays, key=lambda name: (arrays[name].nbytes % CACHE_LINE_BYTES != 0, -arrays[name].dtype.itemsize, name)
    )
    about = {**(metadata or {}), TENSORS: json.dumps(_sums(arrays))}
    about.pop(HEADER, None)
    header: dict[str, object] = {"__metadata__": about} if metadata else {}
    offset = 0
    for name in order:
        array, end = arrays[name], offset + arrays[name].nbytes
        header[name] = {"dtype": _NAMES[array.dtype], "shape": array.shape, "data_offsets": [offset, end]}
        offset = end
    header["__metadata__"] = about
    about[HEADER] = _of_json(header)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-(8 + len(text)) % CACHE_LINE_BYTES)
    with replacing(path, overwrite) as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for name in order:
            file.writelines(pieces(arrays[name]))
    return about[HEADER]


def map_tensors(path: AnyPath) -> tuple[Arrays, dict[str, str]]:
    """Return the arrays of a file, read-only, and its metadata; small files are read, others mapped (`file_bytes`).

    The header is compared with its checksum where it has one, the arrays are not: see `read_tensors`.

    Raises: InputError: there is no such file, or it is a pipe. FormatError: not safetensors, truncated, or a header
    that does not describe exactly the bytes that follow it, or is not the one that was written.
    """
    path = Path(path)
    raw = file_bytes(path)
    if not raw.size:
        raise FormatError(f"{path}: empty file")
    header, payload = _header(raw, path)
    metadata = header.get("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise FormatError(f"{path}: metadata must be text by name")
    rest = {name: value for name, value in metadata.items() if name != HEADER}
    if HEADER in metadata and metadata[HEADER] != _of_json({**header, "__metadata__": rest}):
        raise FormatError(f"{path}: damaged: its header is not what was written")
    header.pop("__metadata__", None)
    spans = {name: _span(entry, f"{path}: tensor {name!a}") for name, entry in header.items()}
    _check_layout([(begin, end) for begin, end, _, _ in spans.values()], payload.size, path)
    tensors = {}
    for name, (begin, end, dtype, shape) in spans.items():
        if (raw.size - payload.size + begin) % dtype.itemsize:
            raise FormatError(f"{path}: tensor {name!a} is not aligned to its {dtype.itemsize}-byte items")
        tensors[name] = payload[begin:end].view(dtype).reshape(shape)
    return tensors, metadata


def read_tensors(path: AnyPath) -> tuple[Arrays, dict[str, str]]:
    """Read a file of ours, each array compared with its checksum; see `map_tensors`.

    Raises: as `map_tensors`; FormatError: an array is not what was written, or has no checksum.
    """
    tensors, metadata = map_tensors(path)
    check_checksums(tensors, metadata, str(path))
    return tensors, metadata


def check_tensors(tensors: ArraysByName, expected: Mapping[str, tuple[str, str]], where: str) -> None:
    """Refuse a file whose arrays are not as expected: name -> (dtypes, dimensions).

    Dimensions are named, one letter or word each; those of one name must be of one length.

    Raises: FormatError: an array is missing, or of another dtype or shape.
    """
    lengths: dict[str, int] = {}
    for name, (dtypes, dimensions) in expected.items():
        array, names = tensors.get(name), dimensions.split()
        if array is None or str(array.dtype) not in dtypes.split() or array.ndim != len(names):
            given = "nothing" if array is None else f"{array.dtype} {array.shape}"
            raise FormatError(f"{where}: {name}: expected {dtypes} ({dimensions}), got {given}")
        for dimension, length in zip(names, array.shape, strict=True):
            if lengths.setdefault(dimension, length) != length:
                raise FormatError(f"{where}: {name}: expected {dimension} = {lengths[dimension]}, got {length}")


def _header(raw: Array, path: Path) -> tuple[dict[str, Any], Array]:
    length = int.from_bytes(raw[:8].tobytes(), "little")
    if raw.size < 8 or length > min(raw.size - 8, _MAX_HEADER_BYTES):
        raise FormatError(f"{path}: expected safetensors: a header of {length} bytes in a file of {raw.size}")
    try:
        header = json.loads(raw[8 : 8 + length].tobytes(), object_pairs_hook=unique_names)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: the safetensors header is not JSON: {error}") from None
    if not isinstance(header, dict):
        raise FormatError(f"{path}: the safetensors header must be an object")
    return header, raw[8 + length :]


def _counts(value: object, where: str) -> list[int]:
    items: list[Any] = value if isinstance(value, list) and len(value) <= 16 else [None]
    if not all(type(item) is int and 0 <= item < 1 << 48 for item in items):
        raise FormatError(f"{where}: expected a short list of counts")
    return items


def _span(entry: object, where: str) -> tuple[int, int, np.dtype, list[int]]:  # type: ignore[type-arg]
    """Return (begin, end, dtype, shape) of one tensor, consistent with itself."""
    if not isinstance(entry, dict) or set(entry) != {"dtype", "shape", "data_offsets"}:
        raise FormatError(f"{where}: expected dtype, shape and data_offsets")
    name, offsets = entry["dtype"], _counts(entry["data_offsets"], where)
    if not isinstance(name, str) or name not in _DTYPES:
        raise FormatError(f"{where}: dtype {ascii(name)[:40]} is none of {', '.join(_DTYPES)}")
    dtype, shape = _DTYPES[name], _counts(entry["shape"], where)
    if len(offsets) != 2 or offsets[1] - offsets[0] != math.prod(shape) * dtype.itemsize:
        raise FormatError(f"{where}: {name} {shape} does not fill bytes {offsets}")
    return offsets[0], offsets[1], dtype, shape


def _check_layout(spans: list[tuple[int, int]], size: int, path: Path) -> None:
    """Check that tensors follow each other without holes or overlap, to the last byte."""
    position = 0
    for begin, end in sorted(spans):
        if begin != position:
            raise FormatError(f"{path}: tensors overlap or leave a hole at byte {position}")
        position = end
    if position != size:
        raise FormatError(f"{path}: the header describes {position} bytes of tensors, the file has {size}")
