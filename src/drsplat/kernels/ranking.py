"""The best of many scores of each row, kept while more of them come (native)."""

import numpy as np

from .. import _native
from ..base.arrays import Float32, UInt16
from ..errors import InputError
from .splats import checked_isa


def keep_best(
    scores: Float32[np.ndarray, "t r"],
    names: UInt16[np.ndarray, "t r"],
    more: Float32[np.ndarray, "c r"],
    first: int,
    *,
    threads: int = 0,
    isa: str = "",
) -> None:
    """Let higher scores take the place of lower ones, in place; of equal ones the earlier stays in front.

    scores: of each row the best, highest first, and their `names`. more: further scores, named first, first + 1, ...

    Raises: InputError: more than 256 scores a row, names above 65,535, arrays that are read-only or do not fit.
    Twin: tests/twins/ranking.py::keep_best.
    """
    try:
        _native.keep_best(scores, names, np.ascontiguousarray(more), first, threads, checked_isa(isa))
    except (TypeError, ValueError) as error:
        raise InputError(f"scores {scores.shape}, names {names.shape}, found {more.shape}: {error}") from None
