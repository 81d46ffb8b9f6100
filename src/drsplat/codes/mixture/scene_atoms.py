"""Atoms that are no mask's: typical features of the scene, by k-means on the sphere."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from ...errors import InputError
from ...kernels.mixture import Dictionary, nearest_centres, nearest_members
from .dictionary import quantised

ITERATIONS = 4
POINTS_PER_ATOM = 8
NEIGHBOURS = 16  # that each row may be made of
OVERLAP = 8  # members of a group, in groups' fair shares: few nearest atoms lie in another group


@dataclass(frozen=True, eq=False)
class SceneAtoms:
    """vectors: unit atoms. centres: of groups of them. members: the atoms near each centre, overlapping."""

    vectors: Float32[np.ndarray, "v D"]
    centres: Float32[np.ndarray, "g D"]
    members: Int32[np.ndarray, "g m"]
    coded: Dictionary

    def __len__(self) -> int:
        return len(self.vectors)

    def near(self, features: Float32[np.ndarray, "n D"], *, threads: int = 0) -> Int32[np.ndarray, "n w"]:
        """The atoms nearest to each feature, among those of its nearest group; best first."""
        wanted = min(NEIGHBOURS, self.members.shape[1])
        groups = nearest_centres(features, self.centres, threads=threads)
        order = np.argsort(groups, kind="stable")  # so that a group's atoms stay in the cache
        near = np.empty((len(features), wanted), np.int32)
        near[order] = nearest_members(features[order], self.coded, groups[order], self.members, wanted, threads=threads)
        return near


def train_scene_atoms(points: Float32[np.ndarray, "n D"], count: int, *, seed: int = 0, threads: int = 0) -> SceneAtoms:
    """`count` atoms for unit `points`, fewer where there are fewer points; the same bits for any threads.

    Raises: InputError: no points, or none wanted.
    Source: Dhillon & Modha 2001 (spherical k-means).
    """
    if count < 1 or not len(points):
        raise InputError(f"cannot make {count} atoms of {len(points)} points")
    vectors = spherical_kmeans(points, min(count, len(points)), seed, threads)
    centres = spherical_kmeans(vectors, max(1, round(len(vectors) ** 0.5)), seed, threads)
    size = min(len(vectors), OVERLAP * -(-len(vectors) // len(centres)))
    # einsum and not a matrix product, whose last bits depend on how many threads NumPy's library takes
    nearness = np.einsum("gd,vd->gv", centres, vectors)
    members = np.argsort(-nearness, axis=1, kind="stable")[:, :size].astype(np.int32)
    return SceneAtoms(vectors, centres, members, quantised(vectors))


def spherical_kmeans(
    points: Float32[np.ndarray, "n D"], count: int, seed: int, threads: int
) -> Float32[np.ndarray, "c D"]:
    """Unit centres. One that serves no point moves to the point that is served worst."""
    drawn = np.random.default_rng(seed).choice(len(points), count, replace=False)
    centres = np.ascontiguousarray(points[np.sort(drawn)])
    for _ in range(ITERATIONS):
        nearest = nearest_centres(points, centres, threads=threads)
        moved = _means(points, nearest, centres)
        if np.array_equal(moved, centres):
            break
        centres = moved
    return centres


def _means(
    points: Float32[np.ndarray, "n D"], nearest: Int32[np.ndarray, " n"], centres: Float32[np.ndarray, "c D"]
) -> Float32[np.ndarray, "c D"]:
    order = np.argsort(nearest, kind="stable")
    served, starts = np.unique(nearest[order], return_index=True)
    sums = np.add.reduceat(points[order].astype(np.float64), starts, axis=0)
    norms = np.linalg.norm(sums, axis=1, keepdims=True)
    moved = centres.copy()
    kept = norms[:, 0] > 0
    moved[served[kept]] = (sums[kept] / norms[kept]).astype(np.float32)
    idle = np.setdiff1d(np.arange(len(centres)), served)
    if len(idle):
        fit = np.einsum("nd,nd->n", points, moved[nearest])
        moved[idle] = points[np.argsort(fit, kind="stable")[: len(idle)]]
    return moved
