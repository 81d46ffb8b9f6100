"""The device that scenes are drawn, registered and trained on, chosen here and nowhere else; arrays on it or here."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np

from ...base.arrays import Anywhere
from ...errors import InputError, MissingExtraError
from .engine import Engine, cuda_engine, unavailable

DEVICES = ("auto", "cpu", "cuda")
Device = Literal["cpu", "cuda"]

_in_use: list[Device] = ["cpu"]


def on_host(array: Any) -> np.ndarray:
    """Return an array as NumPy's, copied from the device where it is there."""
    return array.get() if hasattr(array, "get") else array


def placed(array: np.ndarray, like: Anywhere) -> Anywhere:
    """Return an array where another one is."""
    return np.asarray(array, like=like)


def contiguous(array: Anywhere) -> Anywhere:
    """Return an array row after row, as kernels read it: libraries choose the layouts of their results."""
    return np.ascontiguousarray(array, like=array)


def chosen_device(device: str) -> Device:
    """Return what "auto" stands for here: CUDA where CuPy and a GPU are at hand, else the CPU.

    Raises: InputError: no such device. MissingExtraError: "cuda" cannot be used; says why.
    """
    if device not in DEVICES:
        raise InputError(f"device: expected one of {DEVICES}, got {device!r}")
    if device == "cpu":
        return "cpu"
    reason = unavailable()
    if reason is None:
        return "cuda"
    if device == "cuda":
        raise MissingExtraError(reason)
    return "cpu"


@contextmanager
def using_device(device: str) -> Iterator[Device]:
    """Draw and register on a device: scenes that are laid out within (`splat_arrays`) are laid out there.

    It holds for the whole process, so that threads that a function starts take the same one.

    Raises: InputError, MissingExtraError: see `chosen_device`.
    """
    chosen = chosen_device(device)
    _in_use.append(chosen)
    try:
        yield chosen
    finally:
        _in_use.pop()


def device_in_use() -> Device:
    """Return the device of scenes that are laid out now."""
    return _in_use[-1]


def engine_in_use() -> Engine | None:
    """Return the GPU where it is in use, None on the CPU."""
    return cuda_engine() if device_in_use() == "cuda" else None
