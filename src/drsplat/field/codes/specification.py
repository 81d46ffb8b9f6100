"""Specification of a field's code: `PQ`, `Mixture`, the `Smaller` of the two, or a trained `Codebook`."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

from ...errors import InputError
from ...kernels.algebra import CENTROIDS
from .codebook import Codebook
from .mixture.encoding import DEFAULT_ATOMS_PER_ROW, MAX_SCENE_ATOMS, ROWS_PER_SCENE_ATOM

DEFAULT_SUBVECTORS = 128
_NORM_BYTES = 4  # of a PQ row's inverse norm
_ATOM_BYTES = 8  # of an atom besides its numbers: scale and mask


@dataclass(frozen=True)
class PQ:
    """Product quantisation, the paper's, with a codebook that is trained on features spread over the scene.

    subvectors: bytes per row; None: 128, or the largest power of two below it that divides the feature's size.
    """

    subvectors: int | None = None

    def parts(self, dim: int) -> int:
        return self.subvectors or math.gcd(DEFAULT_SUBVECTORS, dim)


@dataclass(frozen=True)
class Mixture:
    """Mixture code of `atoms` of the scene's masks and typical features per row, 3 atoms + 2 bytes: docs/mixture.md."""

    atoms: int = DEFAULT_ATOMS_PER_ROW


@dataclass(frozen=True)
class Smaller:
    """Choice of `PQ` or `Mixture`, whichever takes fewer bytes for the scene at hand."""

    atoms: int = DEFAULT_ATOMS_PER_ROW

    def chosen(self, rows: int, masks: int, dim: int) -> PQ | Mixture:
        smaller = choose_code(rows, masks, dim, self.atoms).name
        return Mixture(self.atoms) if smaller == "mixture" else PQ()


CodeSpecification = PQ | Mixture | Smaller | Codebook


class Choice(NamedTuple):
    """Name of the smaller code, and the bytes of each: rows, and dictionary or codebook."""

    name: Literal["pq", "mixture"]
    pq_bytes: int
    mixture_bytes: int


def choose_code(n_rows: int, n_masks: int, dim: int, atoms_per_row: int = DEFAULT_ATOMS_PER_ROW) -> Choice:
    """Choose the mixture where it takes fewer bytes in all, as if every mask were used; else PQ of 128 bytes per row.

    With 512 numbers and 4 atoms per row the mixture is smaller from about 5 rows per mask on.

    Raises: InputError: a number of rows, masks or numbers that cannot be.
    """
    if n_rows < 0 or n_masks < 0 or dim < 1:
        raise InputError(f"{n_rows} rows, {n_masks} masks, {dim} numbers: expected counts")
    pq = n_rows * (DEFAULT_SUBVECTORS + _NORM_BYTES) + CENTROIDS * dim * 4
    atoms = n_masks + min(MAX_SCENE_ATOMS, n_rows // ROWS_PER_SCENE_ATOM)
    mixture = n_rows * (3 * atoms_per_row + 2) + atoms * (dim + _ATOM_BYTES)
    return Choice("mixture" if mixture < pq else "pq", pq, mixture)
