"""What happens when the memory of a model's device is full: smaller batches, and else words."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

from ..errors import DrSplatError

Answer = TypeVar("Answer")


def fitting(compute: Callable[[Any], Answer], items: Any, what: str) -> list[Answer]:
    """compute(items) alone, or of its halves, and theirs, as far as the memory asks for it.

    items: anything with a length that can be sliced. what: they, in the plural.

    Raises: DrSplatError: not even one fits.
    """
    torch = import_module("torch")
    try:
        return [compute(items)]
    except torch.cuda.OutOfMemoryError as error:
        full = str(error)
    torch.cuda.empty_cache()  # here, where nothing of the attempt is held any more
    half = len(items) // 2
    if half == 0:
        raise DrSplatError(
            f"the GPU's memory is full, {what} do not fit even one at a time: close what else uses the GPU, take a "
            f"smaller model, or compute on device 'cpu'. {full}"
        )
    return [*fitting(compute, items[:half], what), *fitting(compute, items[half:], what)]
