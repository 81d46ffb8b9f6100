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
    encode_mixture,
    encode_rows,
    encode_with,
    learn_scene_atoms,
    mixed_of,
    regrown_mixture,
)
from .scene_atoms import SceneAtoms, train_scene_atoms

__all__ = [
    "DEFAULT_ATOMS_PER_ROW", "AtomTable", "Mixed", "MixtureCode", "MixtureSource", "Part", "SceneAtoms",
    "encode_mixture", "encode_rows", "encode_with", "learn_scene_atoms", "mixed_of", "mixture_from_tensors",
    "quantised", "recoded", "regrown_mixture", "train_scene_atoms",
]  # fmt: skip
