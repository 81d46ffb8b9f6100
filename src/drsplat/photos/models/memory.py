"""Recovery when a device's memory is full: smaller batches, then a clear error."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

from ...errors import DrSplatError

Answer = TypeVar("Answer")


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
