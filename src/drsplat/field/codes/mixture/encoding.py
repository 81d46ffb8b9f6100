"""Rows of W to a mixture code, a block of rows at a time: there is never a dense matrix of all features."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from ....base.arrays import (
    Embeddings,
    Flags,
    Ids,
    Indices,
    OtherEmbeddings,
    OtherIds,
    OtherIndices,
    Sparse,
    WholeNumbers,
)
from ....base.contents import release
from ....base.working import Track, untracked
from ....errors import InputError
from ....kernels.mixture import MAX_ATOMS, MAX_ATOMS_PER_ROW, Candidates, Dictionary, Encoded, mixture_encode
from .code import MixtureCode, packed
from .dictionary import SCENE_ATOM, AtomTable, quantised
from .scene_atoms import POINTS_PER_ATOM, SceneAtoms, train_scene_atoms

BLOCK_ROWS = 8192
DEFAULT_ATOMS_PER_ROW = 4
MAX_SCENE_ATOMS = 4096
ROWS_PER_SCENE_ATOM = 16


@runtime_checkable
class MixtureSource(Protocol):
    """Source of the masks that features are mixtures of, such as `Evidence`."""

    @property
    def weights(self) -> Sparse: ...
    @property
    def embeddings(self) -> Embeddings: ...
    def __len__(self) -> int: ...
    def features(self, begin: int, end: int, *, threads: int = 0) -> Embeddings: ...
    def rows(self, index: WholeNumbers) -> "MixtureSource": ...


class Mixed(NamedTuple):
    """Code and its scene atoms. scene_places: numbers among the scene's atoms of those in the code, in its order."""

    code: MixtureCode
    scene_places: Ids


def encode_mixture(
    source: MixtureSource,
    atoms_per_row: int = DEFAULT_ATOMS_PER_ROW,
    *,
    scene_atoms: int | SceneAtoms | None = None,
    seed: int = 0,
    threads: int = 0,
    track: Track = untracked,
) -> MixtureCode:
    """Encode every row as a mixture: 3 * atoms_per_row + 2 bytes each, and the atoms that are used.

    A row is made of the masks in it and of scene atoms near its feature. scene_atoms: those, or how many
    to learn of these rows; None: one per 16 rows, up to 4,096; 0: none. Where rows use more than 65,536 atoms, all are
    coded again with those used most. Equal to the bit for any number of threads.

    Raises: InputError: no rows, nothing to mix, atoms_per_row not in 1..16, or more than 32,768 scene atoms.
    """
    if not isinstance(scene_atoms, SceneAtoms):
        scene_atoms = learn_scene_atoms(source, scene_atoms, seed=seed, threads=threads)
    return encode_with(source, atoms_per_row, scene_atoms, threads=threads, track=track).code


def encode_with(
    source: MixtureSource, atoms_per_row: int, scene: SceneAtoms | None, *, threads: int = 0, track: Track = untracked
) -> Mixed:
    """Encode rows as `encode_mixture` does, with scene atoms that are trained already, or none."""
    if not 1 <= atoms_per_row <= MAX_ATOMS_PER_ROW:
        raise InputError(f"expected 1 to {MAX_ATOMS_PER_ROW} atoms per row, got {atoms_per_row}")
    if not len(source) or not len(source.embeddings):
        raise InputError(f"no code of {len(source)} rows and {len(source.embeddings)} masks")

    def encode(columns: Ids | None) -> Encoded:
        return encode_rows(source, columns, scene, atoms_per_row, threads=threads, track=track)

    return mixed_of(encode, source.embeddings, scene)


def mixed_of(encode: Callable[[Ids | None], Encoded], embeddings: Embeddings, scene: SceneAtoms | None) -> Mixed:
    """Return the code of rows that are encoded with all masks, or with the most used of them, as many as fit.

    encode: see `encode_rows`, given its `columns`.
    """
    encoded = encode(None)
    while len(used := atoms_by_use(encoded)) > MAX_ATOMS:
        own = used[used < len(embeddings)][: MAX_ATOMS - len(scene or ())]
        encoded = encode(np.sort(own).astype(np.int32))
    return assemble(encoded, used, embeddings, scene)


def learn_scene_atoms(
    source: MixtureSource, wanted: int | None = None, *, seed: int = 0, threads: int = 0
) -> SceneAtoms | None:
    """Learn typical features of rows; None where none are wanted or no row has a feature.

    wanted: how many; None: one per 16 rows, up to 4,096.

    Raises: InputError: more than 32,768 are wanted.
    """
    if wanted is None:
        wanted = min(MAX_SCENE_ATOMS, len(source) // ROWS_PER_SCENE_ATOM)
    if not 0 <= wanted <= MAX_ATOMS // 2:
        raise InputError(f"expected 0 to {MAX_ATOMS // 2:,} scene atoms, got {wanted:,}")
    count = min(len(source), POINTS_PER_ATOM * wanted)
    spread = np.linspace(0, len(source) - 1, count).astype(np.int64)
    points = source.rows(spread).features(0, count, threads=threads)
    directed = np.ascontiguousarray(points[points.any(1)])
    if not wanted or not len(directed):
        return None
    return train_scene_atoms(directed, wanted, seed=seed, threads=threads)


def encode_rows(
    source: MixtureSource, columns: OtherIds | None, scene: SceneAtoms | None, atoms_per_row: int, *,
    threads: int = 0, track: Track = untracked,
) -> Encoded:  # fmt: skip
    """Encode each row by itself: the same to the bit whatever rows are coded with it.

    columns: whose embeddings may be atoms; None: all. Ids of the result are columns, then atoms of the scene.
    """
    rows, masks = len(source), len(source.embeddings)
    held = np.zeros(masks, bool)
    held[source.weights.indices] = True
    own = np.flatnonzero(held) if columns is None else columns[held[columns]]
    parts = [quantised(source.embeddings[own])] + ([scene.coded] if scene else [])
    dictionary = Dictionary(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    number = np.full(masks, -1, np.int32)
    number[own] = np.arange(len(own), dtype=np.int32)
    ids = np.empty((rows, atoms_per_row), np.int32)
    weights, scales = np.empty((rows, atoms_per_row), np.uint8), np.empty(rows, np.float32)
    for begin in track(range(0, rows, BLOCK_ROWS), "coding Gaussians"):
        block = slice(begin, min(begin + BLOCK_ROWS, rows))
        features = source.features(block.start, block.stop, threads=threads)
        indptr = source.weights.indptr[block.start : block.stop + 1].astype(np.int64)
        atoms = number[source.weights.indices[indptr[0] : indptr[-1]]]
        kept = np.concatenate([[0], np.cumsum(atoms >= 0)])
        further = np.empty((len(features), 0), np.int32)
        if scene is not None:
            further = scene.near(features, threads=threads) + np.int32(len(own))
        candidates = Candidates(kept[indptr - indptr[0]], atoms[atoms >= 0], further)
        ids[block], weights[block], scales[block] = mixture_encode(
            features, dictionary, candidates, atoms_per_row, threads=threads
        )
        release(source.weights.indices, source.weights.data)
    names = np.concatenate([own, masks + np.arange(len(scene or ())), [0]]).astype(np.int32)  # 0: of no atom
    return Encoded(names[ids], weights, scales)


def atoms_by_use(encoded: Encoded) -> Indices:
    """Return the atoms with a weight in any row that has a direction, most used first, close together for scans."""
    counts = (encoded.weights > 0) & (encoded.scales.astype(np.float16) > 0)[:, None]
    uses = np.bincount(encoded.ids[counts])
    order = np.argsort(-uses, kind="stable")
    return order[uses[order] > 0]


def assemble(encoded: Encoded, used: Indices, embeddings: OtherEmbeddings, scene: SceneAtoms | None) -> Mixed:
    """Return the code of the rows with the atoms that they use; parts without weight name the first atom."""
    kept = used if len(used) else np.zeros(1, np.int64)  # no row has a direction
    is_mask = kept < len(embeddings)
    places = kept[~is_mask] - len(embeddings)
    parts = [quantised(embeddings[kept[is_mask]])] + ([Dictionary(*(a[places] for a in scene.coded))] if scene else [])
    order = np.argsort(np.argsort(~is_mask, kind="stable"))  # masks come first in these
    dictionary = Dictionary(*(np.concatenate(arrays)[order] for arrays in zip(*parts, strict=True)))
    atoms = AtomTable(dictionary, np.where(is_mask, kept, SCENE_ATOM).astype(np.int32))
    number = np.zeros(len(embeddings) + len(scene or ()), np.uint16)
    number[kept] = np.arange(len(kept), dtype=np.uint16)
    ids = np.where(encoded.weights > 0, number[encoded.ids], 0).astype(np.uint16)
    return Mixed(MixtureCode(packed(ids, encoded.weights, encoded.scales), atoms), places.astype(np.int32))


class Regrown(NamedTuple):
    """Updated code. directed: which of the rows coded again have a direction; the others are left out."""

    mixed: Mixed
    directed: Flags


def regrown_mixture(
    before: Mixed,
    scene: SceneAtoms | None,
    columns: OtherIds,
    kept: OtherIndices,
    source: MixtureSource,
    keys: WholeNumbers,
    *,
    threads: int = 0,
    track: Track = untracked,
) -> Regrown:
    """Join the rows `kept` of an older code with all rows of `source`, to the bit as if all were coded now.

    scene: the atoms that both are coded with. columns: the new number of each old column that the kept rows use.
    keys: of the kept rows, then of those of `source`: rows come in their order.
    """
    masks = before.code.atoms.masks
    atoms = columns[masks]
    atoms[masks == SCENE_ATOM] = before.scene_places + np.int32(len(source.embeddings))
    ids, weights, scales = before.code.unpacked(kept)
    old = Encoded(atoms[ids], weights, scales.astype(np.float32))
    new = encode_rows(source, None, scene, before.code.atoms_per_row, threads=threads, track=track)
    directed = new.scales.astype(np.float16) > 0
    rows = np.concatenate([np.ones(len(kept), np.bool_), directed])
    order = np.argsort(keys, kind="stable")
    places = order[rows[order]]
    encoded = Encoded(*(np.concatenate(pair)[places] for pair in zip(old, new, strict=True)))
    return Regrown(assemble(encoded, atoms_by_use(encoded), source.embeddings, scene), directed)
