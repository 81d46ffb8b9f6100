"""Arrays of NumPy or of a device's library: made alike, copied from one to the other."""

from importlib import import_module
from typing import Any

import numpy as np

from ..arrays import Anywhere, Float32


def on_host(array: Any) -> np.ndarray:
    """Return an array as NumPy's, copied from the device where it is there."""
    copied: np.ndarray = array.get() if hasattr(array, "get") else array
    return copied


def placed(array: np.ndarray, like: Anywhere) -> Anywhere:
    """Return an array where another one is."""
    return np.asarray(array, like=like)


def normals(rng: np.random.Generator, like: Float32[Anywhere, "n 3"]) -> Float32[Anywhere, "n 3"]:
    """Draw normal numbers of an array's shape where it is; `rng` decides which, there as well."""
    if isinstance(like, np.ndarray):
        return rng.standard_normal(like.shape, np.float32)
    random = import_module("cupy.random")  # where there are such arrays

    drawn: Anywhere = random.Generator(random.Philox4x3210(int(rng.integers(2**31)))).standard_normal(
        like.shape, np.float32
    )
    return drawn
