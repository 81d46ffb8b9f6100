"""Update of a mixture code after some rows of W have changed: these are coded again, the others only renumbered."""

from typing import NamedTuple

import numpy as np

from ....base.arrays import Bool, Int32, Int64, Integer
from ....kernels.kmeans import Track, untracked
from ....kernels.mixture import MAX_ATOMS, Encoded
from .dictionary import SCENE_ATOM
from .encoding import Mixed, MixtureSource, assemble, atoms_by_use, encode_rows, plan_of
from .scene_atoms import SceneAtoms


class Regrown(NamedTuple):
    """Updated code. directed: which of the rows coded again have a direction; the others are left out."""

    mixed: Mixed
    directed: Bool[np.ndarray, " t"]


def fits_at_once(num_masks: int, scene: SceneAtoms | None) -> bool:
    """Return whether all atoms can be addressed at once, so that no column is ever left out."""
    return num_masks + (len(scene) if scene else 0) <= MAX_ATOMS


def regrown_mixture(
    before: Mixed,
    scene: SceneAtoms | None,
    columns: Int32[np.ndarray, " m"],
    kept: Int64[np.ndarray, " k"],
    source: MixtureSource,
    keys: Integer[np.ndarray, " r"],
    *,
    threads: int = 0,
    track: Track = untracked,
) -> Regrown:
    """Join the rows `kept` of an older code with all rows of `source`, to the bit as if all were coded now.

    scene: the atoms that both are coded with. columns: the new number of each old column that the kept rows use.
    keys: of the kept rows, then of those of `source`: rows come in their order.
    """
    every = np.arange(len(source.embeddings), dtype=np.int32)
    plan = plan_of(source.embeddings, every, scene)
    old = _planned(before, columns, kept, plan.first_scene)
    new = encode_rows(source, plan, before.code.atoms_per_row, threads=threads, track=track)
    directed = new.scales.astype(np.float16) > 0
    rows = np.concatenate([np.ones(len(kept), np.bool_), directed])
    order = np.argsort(keys, kind="stable")
    places = order[rows[order]]
    encoded = Encoded(*(np.concatenate(pair)[places] for pair in zip(old, new, strict=True)))
    return Regrown(assemble(encoded, plan, every, atoms_by_use(encoded)), directed)


def _planned(
    before: Mixed, columns: Int32[np.ndarray, " m"], kept: Int64[np.ndarray, " k"], first_scene: int
) -> Encoded:
    """Return rows of an older code with the atoms' numbers of the new plan."""
    masks = before.code.atoms.masks
    atoms = columns[masks]
    atoms[masks == SCENE_ATOM] = before.scene_places + np.int32(first_scene)
    ids, weights, scales = before.code.unpacked(kept)
    return Encoded(atoms[ids], weights, scales.astype(np.float32))
