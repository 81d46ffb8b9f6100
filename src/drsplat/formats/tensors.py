"""Safetensors files: written whole or not at all, large ones mapped, headers never trusted.

Source: the safetensors format (8 bytes little-endian header length, JSON header, tensor bytes).
"""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Arrays, ArraysByName
from ..base.contents import file_bytes, pieces
from ..errors import FormatError, InputError
from .checksums import check_checksums, check_header, header_checksum, with_checksums
from .json_files import unique_names
from .replacing import replacing

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
    path: str | os.PathLike[str],
    tensors: ArraysByName,
    metadata: Mapping[str, str] | None = None,
    overwrite: bool = False,
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
    header: dict[str, object] = {"__metadata__": dict(metadata)} if metadata else {}
    offset = 0
    for name in order:
        array, end = arrays[name], offset + arrays[name].nbytes
        header[name] = {"dtype": _NAMES[array.dtype], "shape": array.shape, "data_offsets": [offset, end]}
        offset = end
    summed = with_checksums(header, arrays)
    text = json.dumps(summed, separators=(",", ":")).encode()
    text += b" " * (-(8 + len(text)) % CACHE_LINE_BYTES)
    with replacing(path, overwrite) as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for name in order:
            file.writelines(pieces(arrays[name]))
    return header_checksum(summed["__metadata__"])


def map_tensors(path: str | os.PathLike[str]) -> tuple[Arrays, dict[str, str]]:
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
    check_header(header, str(path))
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise FormatError(f"{path}: metadata must be text by name")
    spans = {name: _span(entry, f"{path}: tensor {name!a}") for name, entry in header.items()}
    _check_layout([(begin, end) for begin, end, _, _ in spans.values()], payload.size, path)
    tensors = {}
    for name, (begin, end, dtype, shape) in spans.items():
        if (raw.size - payload.size + begin) % dtype.itemsize:
            raise FormatError(f"{path}: tensor {name!a} is not aligned to its {dtype.itemsize}-byte items")
        tensors[name] = payload[begin:end].view(dtype).reshape(shape)
    return tensors, metadata


def read_tensors(path: str | os.PathLike[str]) -> tuple[Arrays, dict[str, str]]:
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


def _header(raw: np.ndarray, path: Path) -> tuple[dict[str, Any], np.ndarray]:
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


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 48


def _counts(value: object, where: str) -> list[int]:
    if not isinstance(value, list) or len(value) > 16 or not all(_is_count(item) for item in value):
        raise FormatError(f"{where}: expected a short list of counts")
    return value


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
