"""The mixture code: a feature as a few of the scene's own mask embeddings with weights.

Features are mixtures of mask embeddings to begin with, so that a few of them, and one of the scene's
typical features, come nearer in 14 bytes than 128 bytes that know nothing of the scene. See docs/mixture.md.
"""

from .code import MixtureCode, Part, mixture_from_tensors, recoded
from .dictionary import AtomTable, quantised
from .encoding import (
    DEFAULT_ATOMS_PER_ROW,
    Mixed,
    MixtureSource,
    assemble,
    atoms_by_use,
    encode_mixture,
    encode_rows,
    encode_with,
    fits_at_once,
    learn_scene_atoms,
    left_in,
    plan_of,
    regrown_mixture,
)
from .scene_atoms import SceneAtoms, train_scene_atoms

__all__ = [
    "DEFAULT_ATOMS_PER_ROW", "AtomTable", "Mixed", "MixtureCode", "MixtureSource", "Part", "SceneAtoms", "assemble",
    "atoms_by_use", "encode_mixture", "encode_rows", "encode_with", "fits_at_once", "learn_scene_atoms", "left_in",
    "mixture_from_tensors", "plan_of", "quantised", "recoded", "regrown_mixture", "train_scene_atoms",
]  # fmt: skip
