"""Kinds and shapes of arrays, for annotations: jaxtyping's for whoever checks types, and notes that cost nothing else.

Loading jaxtyping takes as long as loading NumPy, loading SciPy's sparse arrays twice that. So `Sparse` and `PilImage`
are of their libraries only where jaxtyping is loaded already, as by the tests.
"""

import sys
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np

    Anywhere: TypeAlias = np.ndarray
else:
    Anywhere = Any  # an array of NumPy, or of a device's library that answers NumPy's functions

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import (
        Bool,
        Float,
        Float16,
        Float32,
        Float64,
        Int,
        Int8,
        Int32,
        Int64,
        Integer,
        Num,
        Real,
        Shaped,
        UInt8,
        UInt16,
        UInt32,
        UInt64,
    )
    from PIL.Image import Image as PilImage
    from scipy.sparse import csr_array as Sparse
else:
    from typing import Annotated

    PilImage = Sparse = Any

    Bool = Float = Float16 = Float32 = Float64 = Int = Int8 = Int32 = Int64 = Integer = Num = Real = Shaped = Annotated
    UInt8 = UInt16 = UInt32 = UInt64 = Annotated

__all__ = [
    "Anywhere", "Bool", "Float", "Float16", "Float32", "Float64", "Int", "Int8", "Int32", "Int64", "Integer", "Num",
    "PilImage", "Real", "Shaped", "Sparse", "UInt8", "UInt16", "UInt32", "UInt64",
]  # fmt: skip
