"""Votes of neighbours on a Gaussian's feature, which may be replaced by another's; nothing is averaged."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ....base.arrays import DoubleRows, Doubles, Embeddings, Ids, IndexRows, Indices, OtherIndices, Vectors
from ....kernels import weighted_rows
from ....scene.gaussians import Gaussians
from ..evidence import Evidence
from .entries import view_runs

SUPPORT_TOLERANCE = 1e-5  # relative: float32 products differ between processors
PARTS_PER_ONE = float(1 << 21)  # products of two are sums of 2^-42, and 2^53 of those are exact
SPARE_NEIGHBOURS = 4  # more than are asked for, as equally near ones come in no order
RECEIVERS_AT_ONCE = 512  # near each other: they share most neighbours

ROWS_AT_ONCE = 8192


@dataclass(frozen=True)
class ModeVoting:
    """Vote by support S_ij = R_j sum_k R_k d_ik g_jk over the neighbours j and k of i, itself among them.

    d_ik = min(1, a_k / a_i)^footprint exp(-|x_i - x_k|^2 / 2 s^2): s is the distance of i to the middle one
    of its `neighbours`, a the product of the two larger scales, so that many small Gaussians on a thing do not
    outvote the large one that it stands on. g_jk = exp((cos(f_j, f_k) - 1) / bandwidth). R is `reliability`.
    Gaussian i takes the feature of the best j where S_ij > (1 + margin) S_ii by more than rounding; of equal ones the
    nearest.

    Source: NormLift (2026), mode voting. Of what we know of it d, g and the margin are open; they, and a, are
    ours.
    Twin: tests/field/test_aggregation_voting.py::slow_donors.
    """

    neighbours: int = 20
    bandwidth: float = 0.1
    margin: float = 0.0
    footprint: float = 0.5

    def donors(self, evidence: Evidence, gaussians: Gaussians, receivers: OtherIndices, threads: int = 0) -> Ids:
        """Return for each row the row whose feature it takes: mostly its own; -1 where it gets none.

        gaussians: those of the rows. receivers: rows that may take another's feature, or get one though they have none.
        """
        trust = reliability(evidence, threads)
        donors = np.where(trust > 0, np.arange(len(trust)), -1).astype(np.int32)
        givers = np.flatnonzero(trust > 0)
        if not len(givers):
            return donors
        means, sizes = gaussians.means, self.sizes(gaussians)
        tree = cKDTree(means[givers])
        for rows in _near_each_other(tree, means, receivers, threads):
            distances, near = nearest(tree, means[rows], self.neighbours + 1, threads)
            voters = Voters(rows, givers[near], distances)
            present = voters.present
            features = evidence.rows(present).features(0, len(present), threads=threads)
            donors[rows] = self.elected(voters, trust[present], sizes[present], features)
        return donors

    def sizes(self, gaussians: Gaussians) -> Doubles:
        """Return what Gaussians count by where many small ones are beside a large one."""
        return footprints(gaussians) ** self.footprint

    def elected(
        self, voters: "Voters", trust: Doubles, sizes: Doubles,
        features: Embeddings,
    ) -> OtherIndices:  # fmt: skip
        """Return the row whose feature each receiver takes, -1 for none.

        trust, sizes, features: of `voters.present`. A receiver's donor depends on its own candidates alone, to the bit.
        """
        rows, candidates = (np.searchsorted(voters.present, array) for array in (voters.rows, voters.candidates))
        # put rows among their own candidates; one that many others coincide with may be missing there
        absent = (trust[rows] > 0) & ~(candidates == rows[:, None]).any(1)
        candidates[absent, 0] = rows[absent]
        middle = voters.distances[:, voters.distances.shape[1] // 2, None]
        near = np.exp(-0.5 * (voters.distances / np.where(middle > 0, middle, 1.0)) ** 2)
        close = near * np.minimum(1, sizes[candidates] / sizes[rows, None])
        # g of all pairs of candidates of each row, from one table of all pairs
        whole = np.rint(features.astype(np.float64) * PARTS_PER_ONE)
        cosines = (whole @ whole.T) / PARTS_PER_ONE**2
        pairs = np.minimum(cosines[candidates[:, :, None], candidates[:, None, :]], 1)
        alike = np.exp((pairs - 1) / self.bandwidth)
        believed = trust[candidates] * close
        support = trust[candidates] * (alike * believed[:, None, :]).sum(2)
        own = np.where(candidates == rows[:, None], support, 0).max(1)
        best = support.argmax(1)[:, None]
        wins = np.take_along_axis(support, best, 1)[:, 0] > (1 + self.margin) * (1 + SUPPORT_TOLERANCE) * own
        taken = np.take_along_axis(candidates, best, 1)[:, 0]
        elected = np.where(wins, taken, np.where(trust[rows] > 0, rows, -1))
        return np.where(elected >= 0, voters.present[elected], -1)


@dataclass(frozen=True, eq=False)
class Voters:
    """Receivers, and the rows around each that have a say, nearest first, with their distances."""

    rows: Indices
    candidates: IndexRows
    distances: DoubleRows

    @cached_property
    def present(self) -> Indices:
        """All these rows, ascending."""
        return np.union1d(self.rows, self.candidates)


def footprints(gaussians: Gaussians) -> Doubles:
    """Return the product of the two larger scales: the area that a Gaussian on a surface covers."""
    sides = np.sort(gaussians.scales.astype(np.float64), axis=1)
    return np.maximum(sides[:, 1] * sides[:, 2], np.finfo(np.float64).tiny)


def _near_each_other(tree: cKDTree, means: Vectors, receivers: OtherIndices, threads: int) -> Iterator[Indices]:
    """Yield the receivers in the order of the tree's leaves, in blocks."""
    rank = np.empty(tree.n, np.int64)
    rank[tree.indices] = np.arange(tree.n)
    nearest = tree.query(means[receivers], workers=threads or -1)[1]
    ordered = receivers[np.argsort(rank[nearest], kind="stable")]
    yield from (ordered[begin : begin + RECEIVERS_AT_ONCE] for begin in range(0, len(ordered), RECEIVERS_AT_ONCE))


def nearest(tree: cKDTree, points: Vectors, count: int, threads: int) -> tuple[DoubleRows, IndexRows]:
    """Return distances and indices of the nearest points of the tree, nearest first; equally near ones by index."""
    more = min(count + SPARE_NEIGHBOURS, tree.n)
    distances, near = tree.query(points, k=np.arange(1, more + 1), workers=threads or -1)
    return nearest_first(distances, near, count)


def nearest_first(distances: DoubleRows, near: IndexRows, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return up to `count` of the nearest of each row, nearest first; equally near ones by index."""
    order = np.lexsort((near, distances), axis=1)[:, :count]
    return np.take_along_axis(distances, order, 1), np.take_along_axis(near, order, 1)


def resultant_lengths(evidence: Evidence, threads: int = 0) -> Doubles:
    """Return the length of each row's weighted mean of unit embeddings: 1 where all votes agree, 0 without votes."""
    weights, rows = evidence.weights, len(evidence)
    # A column of ones beside the embeddings adds up the weights: a row is then (sum of W e, sum of W) but for
    # its scale, and the quotient of the two parts is the length that the kernel divides away.
    ones = np.ones((len(evidence.embeddings), 1), np.float32)
    table = np.concatenate([evidence.embeddings, ones], axis=1)
    lengths = np.zeros(rows)
    for begin in range(0, rows, ROWS_AT_ONCE):
        end = min(begin + ROWS_AT_ONCE, rows)
        csr = weights.indptr, weights.indices, weights.data
        mixed = weighted_rows(*csr, table, begin, end, threads=threads)
        totals = mixed[:, -1].astype(np.float64)
        norms = np.sqrt(np.einsum("nd,nd->n", mixed[:, :-1], mixed[:, :-1], dtype=np.float64))
        lengths[begin:end] = np.divide(norms, totals, out=np.zeros(end - begin), where=totals > 0)
    return np.minimum(lengths, 1)


def reliability(evidence: Evidence, threads: int = 0) -> Doubles:
    """Return |f| N_eff / (N_eff + 1), in [0, 1); 0 without evidence. Source: NormLift (2026), reliability."""
    views = effective_views(evidence)
    return resultant_lengths(evidence, threads) * views / (views + 1)


def effective_views(evidence: Evidence) -> Doubles:
    """Return N_eff = (sum_v W_v)^2 / sum_v W_v^2, the equivalent number of equal views; 0 without any.

    Source: NormLift (2026), reliability.
    """
    weights, count = evidence.weights, len(evidence)
    starts = view_runs(evidence.masks.views[weights.indices], weights.indptr)
    sums = np.add.reduceat(weights.data, starts, dtype=np.float64) if len(starts) else np.empty(0)
    rows = np.searchsorted(weights.indptr, starts, side="right") - 1
    total, squares = np.bincount(rows, sums, count), np.bincount(rows, sums**2, count)
    return np.divide(total**2, squares, out=np.zeros(count), where=squares > 0)
