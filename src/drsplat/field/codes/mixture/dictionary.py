"""Atoms of mixtures: quantised unit vectors."""

from dataclasses import dataclass

import numpy as np

from ....base.arrays import Embeddings, Ids, WholeNumbers
from ....errors import InputError
from ....kernels.mixture import MAX_ATOMS, Dictionary

SCENE_ATOM = -1  # in place of a mask's number: the atom is of none
BLOCK_VECTORS = 512  # near the processor
MIN_ENTRY = 127 / float(np.finfo(np.float32).max)  # 127 over anything smaller is infinite
_DTYPES = {"values": np.int8, "scales": np.float32, "masks": np.int32}


def quantised(vectors: Embeddings) -> Dictionary:
    """Quantise vectors to signed bytes and a scale each; decoded they have unit length, or zero for zero vectors.

    A vector whose entries are all below 3.8e-37 counts as one without length.

    Raises: InputError: a vector that is not finite.
    """
    if not np.isfinite(vectors).all():
        raise InputError("atoms must be finite")
    blocks = [_quantised(vectors[begin : begin + BLOCK_VECTORS]) for begin in range(0, len(vectors), BLOCK_VECTORS)]
    values, scales = zip(*blocks, strict=True) if blocks else ((vectors.astype(np.int8),), (np.empty(0, np.float32),))
    return Dictionary(np.concatenate(values), np.concatenate(scales))


def _quantised(vectors: Embeddings) -> Dictionary:
    largest = np.abs(vectors).max(1, keepdims=True, initial=0)
    steps = np.divide(127, largest, out=np.zeros_like(largest), where=largest > MIN_ENTRY)
    whole = np.rint(vectors * steps)
    squared = np.einsum("ad,ad->a", whole, whole, dtype=np.float64)
    scales = np.divide(1, np.sqrt(squared), out=np.zeros_like(squared), where=squared > 0)
    return Dictionary(whole.astype(np.int8), scales.astype(np.float32))


@dataclass(frozen=True, eq=False)
class AtomTable:
    """Table of up to 65,536 atoms. masks: the column of W whose embedding an atom is, or -1: a scene atom.

    Raises: InputError: arrays that do not fit each other, or scales that are no lengths.
    """

    dictionary: Dictionary
    masks: Ids

    def __post_init__(self) -> None:
        values, scales = self.dictionary
        arrays = {"values": values, "scales": scales, "masks": self.masks}
        for name, array in arrays.items():
            if array.dtype != _DTYPES[name] or array.ndim != 1 + (name == "values"):
                raise InputError(f"atoms: {name}: got {array.dtype} {array.shape}")
        if not len(values) == len(scales) == len(self.masks) or not values.shape[1]:
            raise InputError(f"expected one scale and one mask for each of {len(values)} atoms")
        if not 1 <= len(values) <= MAX_ATOMS:
            raise InputError(f"expected 1 to {MAX_ATOMS:,} atoms, got {len(values):,}")
        if not ((scales >= 0) & (scales <= 1)).all():  # 1 / length of whole numbers
            raise InputError("atoms: scales must lie between 0 and 1")
        if self.masks.min() < SCENE_ATOM:
            raise InputError(f"atoms: mask {self.masks.min()}: expected a column, or -1")

    def __len__(self) -> int:
        return len(self.masks)

    @property
    def dim(self) -> int:
        return int(self.dictionary.values.shape[1])

    @property
    def nbytes(self) -> int:
        values, scales = self.dictionary
        return values.nbytes + scales.nbytes + self.masks.nbytes

    def vectors(self, ids: WholeNumbers) -> Embeddings:
        """Return the unit vectors of some atoms."""
        return self.dictionary.values[ids] * self.dictionary.scales[ids, None]
