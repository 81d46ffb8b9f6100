"""Device and number type that a model computes with."""

import platform
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

from ...errors import DrSplatError, InputError, MissingExtraError

DEVICES = ("auto", "cpu", "cuda", "mps")
DTYPES = ("auto", "float32", "bfloat16", "float16")
_BF16_FLAGS = {"avx512_bf16", "amx_bf16", "bf16"}  # the last is Arm's
Answer = TypeVar("Answer")


def chosen_device(device: str = "auto") -> str:
    """Return the device: "cpu", "cuda" or "mps" for "auto", else the one named, if it is available.

    Raises: InputError: no such device. MissingExtraError: this machine or this torch has not got it.
    """
    torch = import_module("torch")
    if device not in DEVICES:
        raise InputError(f"device: expected one of {', '.join(DEVICES)}, got {device!r}")
    available = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available(), "cpu": True}
    if device == "auto":
        return next(name for name, there in available.items() if there)
    if not available[device]:
        raise MissingExtraError(
            f"device '{device}': torch {torch.__version__} finds none on this machine. Use device "
            "'cpu' or 'auto', or install a torch that is built for it"
        )
    return device


def chosen_dtype(dtype: str, device: str) -> str:
    """Return the dtype; "auto" is half precision on devices where that is faster. Raises: InputError: no such dtype."""
    if dtype not in DTYPES:
        raise InputError(f"dtype: expected one of {', '.join(DTYPES)}, got {dtype!r}")
    if dtype != "auto":
        return dtype
    fast = {"cuda": "float16", "cpu": "bfloat16" if has_fast_bfloat16() else "float32"}
    return fast.get(device, "float32")


def has_fast_bfloat16() -> bool:
    """Return whether the processor multiplies bfloat16 in hardware; elsewhere it is slower than float32.

    The answer is False where the system does not tell (only Linux does).
    """
    if platform.system() != "Linux":
        return False
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            return any(
                not _BF16_FLAGS.isdisjoint(line.split())
                for line in lines
                if line.lower().startswith(("flags", "features"))
            )
    except OSError:
        return False


def fitting(compute: Callable[[Any], Answer], items: Any, what: str) -> list[Answer]:
    """Return the results of computing all items at once, or in ever smaller halves while the GPU's memory is full.

    The results of all batches come in the order of the items.

    items: any sequence that can be sliced. what: name of the items in the plural, for the error.

    Raises: DrSplatError: not even one item fits.
    """
    torch = import_module("torch")
    try:
        return [compute(items)]
    except torch.cuda.OutOfMemoryError as error:
        full = str(error)
    torch.cuda.empty_cache()  # outside of `except`: the traceback would keep the tensors alive
    half = len(items) // 2
    if half == 0:
        raise DrSplatError(
            f"the GPU's memory is full, {what} do not fit even one at a time: close what else uses the GPU, take a "
            f"smaller model, or compute on device 'cpu'. {full}"
        )
    return [*fitting(compute, items[:half], what), *fitting(compute, items[half:], what)]
