"""`.npy` arrays, mapped and not loaded, by NumPy's own reader; nothing in a file is unpickled."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np

from ..base.arrays import Array
from ..base.contents import open_file
from ..errors import FormatError
from .replacing import replacing


def map_npy(path: Path) -> Array:
    """Map the array of integers or floats in `path`, read-only.

    Raises: InputError: there is no such file. FormatError: not a .npy of plain numbers, or shorter
    than its header says.
    """
    open_file(path).close()  # or the error that says what lies there
    return _plain(lambda: np.lib.format.open_memmap(path, "r"), str(path))


def read_npy(content: bytes, where: str) -> Array:
    """Read the array of integers or floats that a file holds. Raises: FormatError: as `map_npy`."""
    return _plain(lambda: np.lib.format.read_array(BytesIO(content), allow_pickle=False), where)


def write_npy(path: Path, array: Array, overwrite: bool = False) -> None:
    """Write `array`, whole or not at all."""
    with replacing(path, overwrite) as file:
        np.save(file, array, allow_pickle=False)


def _plain(load: Callable[[], Array], where: str) -> Array:
    try:
        array = load()
    except Exception as error:  # of damaged files it raises anything
        raise FormatError(f"{where}: expected a whole .npy file of integers or floats: {error}") from None
    if array.dtype.kind not in "iuf" or array.itemsize > 8 or not array.ndim:
        raise FormatError(f"{where}: expected an array of integers or floats, got {array.dtype} {array.shape}")
    return array
