"""Features as mixtures of atoms, searched by looking up the score of each atom."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ....base.arrays import (
    Arrays,
    ArraysByName,
    ByteRows,
    Embedding,
    Embeddings,
    FloatRows,
    Numbers,
    UInt16,
    WholeNumbers,
)
from ....errors import FormatError, InputError
from ....formats.tensors import check_tensors
from ....kernels.algebra import row_products
from ....kernels.mixture import (
    MAX_ATOMS_PER_ROW,
    ROWS_PER_BLOCK,
    Blocks,
    Dictionary,
    mixture_best,
    mixture_scores,
    mixture_select,
    mixture_top,
)
from ..code import Best, Code, Hits, check_run
from ..codebook import Codebook
from ..pq_code import PQCode, pq_code
from .dictionary import AtomTable

_ARRAYS = {
    "mixture_ids": ("uint16", "b k r"), "mixture_weights": ("uint8", "b k r"), "mixture_scales": ("float16", "n"),
    "atoms": ("int8", "a D"), "atom_scales": ("float32", "a"), "atom_segments": ("int32", "a"),
}  # fmt: skip


class Part(NamedTuple):
    """Support of a query in a row. mask: column of W, -1 for scene atoms together. share: (0, 1]."""

    mask: int
    share: float


@dataclass(frozen=True, eq=False)
class MixtureCode:
    """Mixture code of 3 K + 2 bytes per row: feature = scale * sum over K of weight * atom, of unit length.

    Raises: InputError: arrays that do not fit each other, ids of no atom, scales that are no lengths.
    """

    blocks: Blocks
    atoms: AtomTable

    kind = "mixture"

    def __post_init__(self) -> None:
        ids, weights, scales = self.blocks
        dtypes = [array.dtype for array in self.blocks]
        if dtypes != [np.uint16, np.uint8, np.float16] or scales.ndim != 1:
            raise InputError(f"mixtures: expected uint16 ids, uint8 weights, float16 scales (n), got {dtypes}")
        blocks = -(-len(scales) // ROWS_PER_BLOCK)
        fits = ids.ndim == 3 and ids.shape[::2] == (blocks, ROWS_PER_BLOCK)
        if not fits or weights.shape != ids.shape or not 1 <= ids.shape[1] <= MAX_ATOMS_PER_ROW:
            raise InputError(
                f"mixtures: expected ids and weights ({blocks}, 1 to {MAX_ATOMS_PER_ROW}, "
                f"{ROWS_PER_BLOCK}) for {len(scales)} rows, got {ids.shape} and {weights.shape}"
            )
        if ids.max(initial=0) >= len(self.atoms):
            raise InputError(f"mixtures: atom {ids.max()} of {len(self.atoms)}")
        if not (np.isfinite(scales) & (scales >= 0)).all():
            raise InputError("mixtures: scales must be finite and not negative")

    def __len__(self) -> int:
        return len(self.blocks.scales)

    @property
    def dim(self) -> int:
        return self.atoms.dim

    @property
    def atoms_per_row(self) -> int:
        return int(self.blocks.ids.shape[1])

    @property
    def row_bytes(self) -> int:
        return 3 * self.atoms_per_row + 2

    @property
    def nbytes(self) -> int:
        """Bytes of all rows together, without the atoms: see `AtomTable.nbytes`."""
        return sum(array.nbytes for array in self.blocks)

    def run(self, begin: int, end: int) -> "MixtureCode":
        """See Code."""
        check_run(begin, ROWS_PER_BLOCK)
        ids, weights, scales = self.blocks
        blocks = slice(begin // ROWS_PER_BLOCK, -(-end // ROWS_PER_BLOCK))
        return MixtureCode(Blocks(ids[blocks], weights[blocks], scales[begin:end]), self.atoms)

    def scores(self, queries: Embeddings, *, threads: int = 0) -> FloatRows:
        """See Code. Off by some 1e-5, and the same to the bit on any instruction set.

        Raises: InputError: queries of another dimension, or not finite.
        """
        return mixture_scores(self.blocks, self.atoms.dictionary, queries, threads=threads)

    def select(self, query: Embedding, threshold: float, floor: Numbers | None = None, *, threads: int = 0) -> Hits:
        """See Code. Raises: InputError: a query of another dimension, not finite, or not one floor per row."""
        atoms = self.atoms.dictionary
        return Hits(*mixture_select(self.blocks, atoms, query, threshold, floor, threads=threads))

    def top(self, query: Embedding, count: int, *, threads: int = 0) -> Hits:
        """See Code. Raises: InputError: a query of another dimension, not finite, or a count below 1."""
        return Hits(*mixture_top(self.blocks, self.atoms.dictionary, query, count, threads=threads))

    def best(self, queries: Embeddings, *, threads: int = 0) -> Best:
        """See Code. One scan for each 256 queries, 128 with AVX2.

        Raises: InputError: no query, one of another dimension, or not finite.
        """
        return Best(*mixture_best(self.blocks, self.atoms.dictionary, queries, threads=threads))

    def decode(self, rows: slice | WholeNumbers) -> Embeddings:
        """See Code."""
        ids, weights, scales = self.unpacked(rows)
        features = np.zeros((len(ids), self.dim), np.float32)
        for k in range(self.atoms_per_row):
            features += self.atoms.vectors(ids[:, k]) * weights[:, k, None]
        return features * scales.astype(np.float32)[:, None]

    def unpacked(self, rows: slice | WholeNumbers) -> tuple[UInt16[np.ndarray, "n k"], ByteRows, np.ndarray]:
        """Return ids, weights and scales of some rows, row by row."""
        index = np.arange(len(self))[rows]
        block, within = np.divmod(index, ROWS_PER_BLOCK)
        ids, weights, scales = self.blocks
        return ids[block, :, within], weights[block, :, within], scales[index]

    def rows(self, index: slice | WholeNumbers) -> "MixtureCode":
        """See Code. The atoms stay as they are."""
        return MixtureCode(packed(*self.unpacked(index)), self.atoms)

    def parts(self, row: int, query: Embedding, top: int = 5) -> list[Part]:
        """Return the masks of the largest support for `query` in a row, and their shares of all positive support.

        Raises: InputError: no such row, or a query of another dimension.
        """
        if not 0 <= row < len(self) or query.shape != (self.dim,):
            raise InputError(f"row {row} of {len(self)}, query {query.shape}: expected ({self.dim},)")
        ids, weights, _ = (array[0] for array in self.unpacked(np.array([row])))
        support = weights * row_products(self.atoms.vectors(ids).astype(np.float64), query)
        speaking = support > 0
        masks, at = np.unique(self.atoms.masks[ids[speaking]], return_inverse=True)
        sums = np.bincount(at, support[speaking], len(masks))
        order = np.argsort(-sums, kind="stable")[:top]
        return [Part(int(masks[i]), float(sums[i] / sums.sum())) for i in order]

    def tensors(self) -> Arrays:
        """See Code, and `mixture_from_tensors`."""
        arrays = (*self.blocks, *self.atoms.dictionary, self.atoms.masks)
        return dict(zip(_ARRAYS, arrays, strict=True))


def packed(ids: UInt16[np.ndarray, "n k"], weights: ByteRows, scales: np.ndarray) -> Blocks:
    """Lay rows out for scans; the last block is padded with rows of weight 0."""
    count, per_row = ids.shape
    blocks = -(-count // ROWS_PER_BLOCK)

    def blocked(array: np.ndarray) -> np.ndarray:
        whole = np.zeros((blocks * ROWS_PER_BLOCK, per_row), array.dtype)
        whole[:count] = array
        return np.ascontiguousarray(whole.reshape(blocks, ROWS_PER_BLOCK, per_row).transpose(0, 2, 1))

    return Blocks(blocked(ids), blocked(weights), scales.astype(np.float16))


def mixture_from_tensors(tensors: ArraysByName, where: str) -> MixtureCode:
    """Return the code of a file's arrays without copying them: a memory map stays one.

    Raises: FormatError: an array is missing, of another type, or does not fit the others.
    """
    check_tensors(tensors, _ARRAYS, where)
    ids, weights, row_scales, values, scales, masks = (np.asarray(tensors[name]) for name in _ARRAYS)
    try:
        atoms = AtomTable(Dictionary(values, scales), masks)
        return MixtureCode(Blocks(ids, weights, row_scales), atoms)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def recoded(code: Code, codebook: Codebook, *, threads: int = 0) -> PQCode:
    """Encode any code anew with a codebook's product quantisation; decoded a block at a time.

    With the authors' codebook, `official_bytes` of its `codes()` are their 130 bytes per row.

    Raises: InputError: a codebook of another dimension.
    """
    if codebook.dim != code.dim:
        raise InputError(f"a codebook of {codebook.dim} numbers for features of {code.dim}")

    def features(begin: int, end: int) -> Embeddings:
        return code.decode(np.arange(begin, end))

    return pq_code(codebook, codebook.encode_blocks(len(code), features, threads=threads))
