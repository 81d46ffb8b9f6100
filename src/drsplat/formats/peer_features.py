"""Features per Gaussian that other systems have, for `drsplat evaluate --features`: (N, D), a row per Gaussian.

They are `.npy`, or `.safetensors` with one such array, or one whose name has "feature".
"""

from pathlib import Path

import numpy as np

from ..base.arrays import Num
from ..errors import InputError
from .npy import map_npy
from .tensors import map_tensors

FLOATS = (np.float16, np.float32)
OTHERS = (".npz", ".pth", ".pt", ".ckpt")


def read_peer_features(path: Path) -> Num[np.ndarray, "n d"]:
    """Return the features of another system, a row per Gaussian, mapped and not read.

    Raises: InputError: there is no such file, or it holds no features in a form that is known. FormatError: damaged.
    """
    suffix = path.suffix.lower()
    if suffix in OTHERS:
        raise InputError(
            f"{path}: expected .npy or .safetensors, got {suffix}: save one row per Gaussian, "
            'numpy.save("features.npy", features.cpu().half().numpy())'
        )
    if suffix == ".safetensors":
        arrays = map_tensors(path)[0]
        wide = {name: array for name, array in arrays.items() if array.ndim == 2 and array.dtype in FLOATS}
        named = [array for name, array in wide.items() if "feature" in name.lower()] or list(wide.values())
        if len(named) != 1:
            listed = ", ".join(f"{name} {array.shape}" for name, array in list(wide.items())[:6]) or "none"
            raise InputError(
                f"{path}: expected one array of (N, D) floats, or one whose name has 'feature'; found {listed}"
            )
        return named[0]
    found = map_npy(path)
    if found.dtype not in FLOATS or found.ndim != 2:
        raise InputError(
            f"{path}: expected float16 or float32 (N, D), one row per Gaussian; got {found.dtype} {found.shape}"
        )
    return found
