"""Atoms that are no mask's: typical features of the scene, by k-means on the sphere."""

from dataclasses import dataclass

import numpy as np

from ....base.arrays import Embeddings, Float32, Ids, Int32, OtherEmbeddings
from ....errors import InputError
from ....kernels import weighted_rows
from ....kernels.mixture import Dictionary, nearest_centres, nearest_members
from .dictionary import quantised

FIT_ITERATIONS = 4
ATOM_ROUNDS = 2  # of fitting atoms, which start as points: more rounds, or points, make no code truer
POINTS_PER_ATOM = 4
GROUPS_PER_ROOT = 1.5  # times the root of the number of atoms
CANDIDATE_ATOMS = 16  # that each row may be made of
GROUP_SHARES = 12  # members of a group, in fair shares: few of a row's nearest atoms lie in another group
FITTING_GROUP_SHARES = 24  # while atoms move


@dataclass(frozen=True, eq=False)
class SceneAtoms:
    """Atoms that are no mask's. vectors: unit. centres: of groups of them. members: atoms near each, overlapping."""

    vectors: Float32[np.ndarray, "v D"]
    centres: Embeddings
    members: Int32[np.ndarray, "n m"]
    coded: Dictionary

    def __len__(self) -> int:
        return len(self.vectors)

    def near(self, features: Embeddings, *, threads: int = 0) -> Int32[np.ndarray, "n w"]:
        """Return the atoms nearest to each feature, among those of its nearest group; best first."""
        wanted = min(CANDIDATE_ATOMS, self.members.shape[1])
        groups = nearest_centres(features, self.centres, threads=threads)
        order = np.argsort(groups, kind="stable")  # so that a group's atoms stay in the cache
        near = np.empty((len(features), wanted), np.int32)
        near[order] = nearest_members(features[order], self.coded, groups[order], self.members, wanted, threads=threads)
        return near


def train_scene_atoms(points: Embeddings, count: int, *, seed: int = 0, threads: int = 0) -> SceneAtoms:
    """Train `count` atoms on unit `points`, fewer where there are fewer points; the same bits for any threads.

    By k-means in which a point is compared with the atoms around its group's centre alone.

    Raises: InputError: no points, or none wanted.
    Source: Dhillon & Modha 2001 (spherical k-means).
    """
    if count < 1 or not len(points):
        raise InputError(f"cannot make {count} atoms of {len(points)} points")
    vectors = _drawn(points, min(count, len(points)), seed)
    centres = _group_centres(vectors, seed, threads)
    groups = nearest_centres(points, centres, threads=threads)
    order = np.argsort(groups, kind="stable")  # so that a group's atoms stay in the cache
    points, groups = points[order], groups[order]
    for _ in range(ATOM_ROUNDS):
        members = _members(centres, vectors, FITTING_GROUP_SHARES)
        nearest = nearest_members(points, quantised(vectors), groups, members, 1, threads=threads)
        vectors = _means(points, nearest[:, 0], vectors, threads)
    centres = _group_centres(vectors, seed, threads)
    return SceneAtoms(vectors, centres, _members(centres, vectors, GROUP_SHARES), quantised(vectors))


def _group_centres(vectors: Embeddings, seed: int, threads: int) -> OtherEmbeddings:
    return spherical_kmeans(vectors, min(len(vectors), round(GROUPS_PER_ROOT * len(vectors) ** 0.5)), seed, threads)


def _members(centres: Embeddings, vectors: Float32[np.ndarray, "v D"], shares: int) -> Int32[np.ndarray, "n m"]:
    """Return the atoms nearest to each centre, as many as `shares` groups have on average."""
    size = min(len(vectors), shares * -(-len(vectors) // len(centres)))
    # einsum and not a matrix product, whose last bits depend on how many threads NumPy's library takes
    nearness = np.einsum("gd,vd->gv", centres, vectors)
    return np.argsort(-nearness, axis=1, kind="stable")[:, :size].astype(np.int32)


def spherical_kmeans(points: Embeddings, count: int, seed: int, threads: int) -> OtherEmbeddings:
    """Return unit centres; one that serves no point moves to the worst-served point."""
    centres = _drawn(points, count, seed)
    for _ in range(FIT_ITERATIONS):
        moved = _means(points, nearest_centres(points, centres, threads=threads), centres, threads)
        if np.array_equal(moved, centres):
            break
        centres = moved
    return centres


def _drawn(points: Embeddings, count: int, seed: int) -> OtherEmbeddings:
    drawn = np.random.default_rng(seed).choice(len(points), count, replace=False)
    return np.ascontiguousarray(points[np.sort(drawn)])


def _means(points: Embeddings, nearest: Ids, centres: OtherEmbeddings, threads: int) -> OtherEmbeddings:
    """Return the mean direction of each centre's points; the old centre where they cancel out."""
    counts = np.bincount(nearest, minlength=len(centres))
    starts, order = np.append(0, np.cumsum(counts)), np.argsort(nearest, kind="stable").astype(np.int32)
    moved = weighted_rows(starts, order, np.ones(len(order), np.float32), points, 0, len(centres), threads=threads)
    still = ~moved.any(1)
    moved[still] = centres[still]
    idle = np.flatnonzero(counts == 0)
    if len(idle):
        fit = np.einsum("nd,nd->n", points, moved[nearest])
        moved[idle] = points[np.argsort(fit, kind="stable")[: len(idle)]]
    return moved
