"""Kinds and shapes of arrays, for annotations: jaxtyping's for whoever checks types, and notes that cost nothing else.

The most common have a name of their own; all others are spelt out where they stand.

Loading jaxtyping takes as long as loading NumPy, loading SciPy's sparse arrays twice that. So `Sparse` and `PilImage`
are of their libraries only where jaxtyping is loaded already, as by the tests.
"""

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
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

Array: TypeAlias = np.ndarray
"""An array of any kind and shape."""
Vector3 = Float64[np.ndarray, " 3"]
"""A place, direction or size in three dimensions."""
Matrix3 = Float64[np.ndarray, "3 3"]
"""Three rows of three numbers, such as a rotation, or a box's unit directions."""
Matrix4 = Float64[np.ndarray, "4 4"]
"""A transform of points, such as a pose."""
Points = Float64[np.ndarray, "n 3"]
"""Places in three dimensions, a row each."""
Vectors = Float32[np.ndarray, "n 3"]
"""Three numbers of each Gaussian in single precision: its position or its sizes."""
Quats = Float32[np.ndarray, "n 4"]
"""Rotations of Gaussians, (w, x, y, z)."""
Harmonics = Float32[np.ndarray, "n k 3"]
"""Spherical harmonics of Gaussians, RGB last."""
Numbers = Float32[np.ndarray, " n"]
"""A number of each, such as an opacity or a relevancy."""
Doubles = Float64[np.ndarray, " n"]
"""A number of each in double precision."""
Flags = Bool[np.ndarray, " n"]
"""Answers of yes or no of each."""
Ids = Int32[np.ndarray, " n"]
"""A number of something of each, such as its object; -1 for none."""
Indices = Int64[np.ndarray, " n"]
"""A place in another array of each."""
RowIds = Integer[np.ndarray, " m"]
"""Numbers of some of the rows."""
Colors = UInt8[np.ndarray, "n 3"]
"""RGB of each."""
Pixels = UInt8[np.ndarray, "h w 3"]
"""A picture, RGB."""
OtherPixels = UInt8[np.ndarray, "_ _ 3"]
"""A picture of another size than the arguments, RGB."""
Mask = Bool[np.ndarray, "h w"]
"""Pixels of a picture that belong to something."""
MaskIds = Int32[np.ndarray, "h w"]
"""The mask that each pixel of a picture is in; -1 for none."""
Image = Float32[np.ndarray, "h w 3"]
"""A picture of light, RGB, from 0 to 1."""
Embedding = Float32[np.ndarray, " D"]
"""A vector of an encoder."""
Embeddings = Float32[np.ndarray, "n D"]
"""Vectors of an encoder, a row each."""
OtherPoints = Float64[np.ndarray, "m 3"]
"""Places in three dimensions, of another number than `Points` beside them."""
PlanePoints = Float64[np.ndarray, "n 2"]
"""Places in a plane, such as a picture, a row each."""
OtherDoubles = Float64[np.ndarray, " m"]
"""A number in double precision of each, of another number than `Doubles` beside them."""
DoubleRows = Float64[np.ndarray, "n k"]
"""Numbers in double precision, a row of each."""
OtherFlags = Bool[np.ndarray, " m"]
"""Answers of yes or no, of another number than `Flags` beside them."""
OtherIds = Int32[np.ndarray, " k"]
"""A number of something of each, of another number than `Ids` beside them."""
UnsignedIds = UInt32[np.ndarray, " n"]
"""A number of something of each, such as a Gaussian, that is never negative."""
OtherIndices = Int64[np.ndarray, " m"]
"""Places in another array, of another number than `Indices` beside them."""
IndexRows = Int64[np.ndarray, "n k"]
"""Places in another array, a row of them of each."""
WholeNumbers = Integer[np.ndarray, " n"]
"""A whole number of each."""
ByteValues = UInt8[np.ndarray, " n"]
"""A whole number below 256 of each."""
ByteRows = UInt8[np.ndarray, "n k"]
"""Whole numbers below 256, a row of each, such as a code."""
PixelNumbers = Float32[np.ndarray, "h w"]
"""A number of each pixel, such as a depth."""
PixelRows = Float32[np.ndarray, "h w c"]
"""Numbers of each pixel."""
FloatRows = Float32[np.ndarray, "n k"]
"""Numbers in single precision, a row of each."""
OtherEmbeddings = Float32[np.ndarray, "m D"]
"""Vectors of an encoder, of another number than `Embeddings` beside them."""
AnyPoints = Float[np.ndarray, "n 3"]
"""Places in three dimensions, in either precision."""
Matrices = Float64[np.ndarray, "n 3 3"]
"""Three rows of three numbers of each, such as the directions of boxes."""
Spans = Int64[np.ndarray, "n 2"]
"""Two whole numbers of each, such as first and end of a run."""
GreyPixels = UInt8[np.ndarray, "h w"]
"""A picture of one channel."""
LevelMaskIds = Int32[np.ndarray, "*levels h w"]
"""The mask of each level that each pixel of a picture is in; -1 for none."""
SmallIds = UInt16[np.ndarray, " n"]
"""A number of something of each, below 65,536."""
Arrays: TypeAlias = dict[str, np.ndarray]
"""Arrays by name, such as the columns of a file."""
ArraysByName: TypeAlias = Mapping[str, np.ndarray]
"""The same, to read only."""

__all__ = [  # of other libraries; all names above are this module's own
    "Bool", "Float", "Float16", "Float32", "Float64", "Int", "Int8", "Int32", "Int64", "Integer", "Num", "PilImage",
    "Real", "Shaped", "Sparse", "UInt8", "UInt16", "UInt32", "UInt64",
]  # fmt: skip
