"""`.npy` arrays, mapped and not loaded, whose headers are believed only as far as the file is long.

The header is matched, never evaluated, so no file can make Python do anything.
Source: the NPY format 1.0 and 2.0 of NumPy (numpy.lib.format).
"""

import math
import os
import re
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from ..base.arrays import Array
from ..base.contents import open_file
from ..errors import FormatError, InputError
from .replacing import replacing

_MAGIC = b"\x93NUMPY"
_DESCR = re.compile(rb"""['"]descr['"]\s*:\s*['"]([<>|=]?[iuf][1248])['"]""")
_ORDER = re.compile(rb"""['"]fortran_order['"]\s*:\s*(True|False)""")
_SHAPE = re.compile(rb"""['"]shape['"]\s*:\s*\(([\d\s,]{0,200})\)""")
_MAX_ARRAY_BYTES = 1 << 62  # beyond any file, within what NumPy can count


def map_npy(path: Path) -> Array:
    """Map the array of integers or floats in `path`, read-only.

    Raises: InputError: there is no such file. FormatError: not a .npy of plain numbers, or shorter
    than its header says.
    """
    try:
        with open_file(path) as file:
            dtype, shape, order = _header(file, path)
            size, expected = (os.fstat(file.fileno()).st_size, file.tell() + math.prod(shape) * dtype.itemsize)
            if size < expected:
                raise FormatError(f"{path}: truncated: {dtype} {shape} needs {expected} bytes, the file has {size}")
            if 0 in shape:  # nothing to map
                return np.zeros(shape, dtype)
            return np.memmap(file, dtype, "r", file.tell(), shape, order)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None


def read_npy(content: bytes, where: str) -> Array:
    """Read the array of integers or floats that a file holds. Raises: FormatError: as `map_npy`."""
    file = BytesIO(content)
    dtype, shape, order = _header(file, where)
    data, expected = file.read(), math.prod(shape) * dtype.itemsize
    if len(data) < expected:
        raise FormatError(f"{where}: truncated: {dtype} {shape} needs {expected} bytes, there are {len(data)}")
    return np.frombuffer(data, dtype, math.prod(shape)).reshape(shape, order=order)


def write_npy(path: Path, array: Array, overwrite: bool = False) -> None:
    """Write `array`, whole or not at all."""
    with replacing(path, overwrite) as file:
        np.save(file, array, allow_pickle=False)


def _header(file: BinaryIO | BytesIO, path: Path | str) -> tuple[np.dtype[Any], tuple[int, ...], Literal["C", "F"]]:
    if file.read(6) != _MAGIC:
        raise FormatError(f"{path}: expected a .npy file (it does not start with its magic bytes)")
    version = file.read(2)
    length_bytes = {b"\x01\x00": 2, b"\x02\x00": 4}.get(version)
    if length_bytes is None:
        raise FormatError(f"{path}: expected .npy version 1.0 or 2.0, got {tuple(version)}")
    length = int.from_bytes(file.read(length_bytes), "little")
    header = file.read(min(length, 1 << 16))
    descr, order, shape = (pattern.search(header) for pattern in (_DESCR, _ORDER, _SHAPE))
    if len(header) < length or descr is None or order is None or shape is None:
        raise FormatError(f"{path}: expected a header of an array of integers or floats, got {header[:120]!a}")
    numbers = tuple(int(number) for number in re.findall(rb"\d+", shape[1]))
    if not 1 <= len(numbers) <= 8 or math.prod(max(number, 1) for number in numbers) * 8 > _MAX_ARRAY_BYTES:
        raise FormatError(f"{path}: no array has the shape ({ascii(shape[1])[2:-1]})")
    try:
        return np.dtype(descr[1].decode()), numbers, "F" if order[1] == b"True" else "C"
    except TypeError as error:
        raise FormatError(f"{path}: {error}") from error
