"""Arrays of NumPy or of a device's library: made alike, copied from one to the other."""

from typing import Any

import numpy as np

from ...base.arrays import Anywhere


def on_host(array: Any) -> np.ndarray:
    """Return an array as NumPy's, copied from the device where it is there."""
    copied: np.ndarray = array.get() if hasattr(array, "get") else array
    return copied


def placed(array: np.ndarray, like: Anywhere) -> Anywhere:
    """Return an array where another one is."""
    return np.asarray(array, like=like)


def contiguous(array: Anywhere) -> Anywhere:
    """Return an array row after row, as kernels read it: libraries choose the layouts of their results."""
    return np.ascontiguousarray(array, like=array)
