"""Facts about the code of a field, and about a codebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .declaring import Facts

if TYPE_CHECKING:
    from ...field.codes import Code, Codebook


def code_facts(code: Code) -> Facts:
    """Return kind and bytes of a code, and what it is made of."""
    from ...field.codes import PQCode
    from ...field.codes.mixture import MixtureCode

    if isinstance(code, PQCode):
        return {"code": code.kind, **codebook_facts(code.codebook)}
    facts: Facts = {"code": code.kind}
    if isinstance(code, MixtureCode):
        facts |= {
            "atoms_per_row": code.atoms_per_row,
            "num_atoms": len(code.atoms),
            "bytes_per_gaussian": code.row_bytes,
        }
    return facts


def codebook_facts(codebook: Codebook) -> Facts:
    """Return a codebook's hash, and the sizes of its codes."""
    coarse = codebook.coarse
    return {
        "codebook": codebook.hash,
        "num_subvectors": codebook.num_subvectors,
        "num_coarse": 0 if coarse is None else len(coarse),
        "bytes_per_gaussian": codebook.code_bytes,
    }
