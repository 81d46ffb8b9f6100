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
    import numpy as np
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

    Vector3 = Float64[np.ndarray, " 3"]
    Matrix3 = Float64[np.ndarray, "3 3"]
    Points = Float64[np.ndarray, "n 3"]
    Vectors = Float32[np.ndarray, "n 3"]
    RowIds = Int64[np.ndarray, " m"]  # of rows
    Flags = Bool[np.ndarray, " n"]  # of each row
    Ids = Int32[np.ndarray, " n"]  # the number of what each row belongs to, -1 for nothing
    Pixels = UInt8[np.ndarray, "h w 3"]
    OtherPixels = UInt8[np.ndarray, "_ _ 3"]  # of another size than the arguments
else:
    from typing import Annotated

    PilImage = Sparse = Vector3 = Matrix3 = Points = Vectors = RowIds = Flags = Ids = Pixels = OtherPixels = Any

    Bool = Float = Float16 = Float32 = Float64 = Int = Int8 = Int32 = Int64 = Integer = Num = Real = Shaped = Annotated
    UInt8 = UInt16 = UInt32 = UInt64 = Annotated

__all__ = [
    "Anywhere",
    "Bool",
    "Flags",
    "Float",
    "Float16",
    "Float32",
    "Float64",
    "Ids",
    "Int",
    "Int8",
    "Int32",
    "Int64",
    "Integer",
    "Matrix3",
    "Num",
    "OtherPixels",
    "PilImage",
    "Pixels",
    "Points",
    "Real",
    "RowIds",
    "Shaped",
    "Sparse",
    "UInt8",
    "UInt16",
    "UInt32",
    "UInt64",
    "Vector3",
    "Vectors",
]  # fmt: skip
