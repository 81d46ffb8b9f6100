"""Kinds and shapes of arrays, for annotations: jaxtyping's for whoever checks types, and notes that cost nothing else.

Loading jaxtyping takes longer than loading drsplat. Whoever checks with it, as the tests do, has loaded it before.
"""

import sys
from typing import TYPE_CHECKING

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
else:
    from typing import Annotated

    Bool = Float = Float16 = Float32 = Float64 = Int = Int8 = Int32 = Int64 = Integer = Num = Real = Shaped = Annotated
    UInt8 = UInt16 = UInt32 = UInt64 = Annotated

__all__ = [
    "Bool", "Float", "Float16", "Float32", "Float64", "Int", "Int8", "Int32", "Int64", "Integer", "Num", "Real",
    "Shaped", "UInt8", "UInt16", "UInt32", "UInt64",
]  # fmt: skip
