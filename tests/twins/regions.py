"""The slow twin of `kernels.regions`: dictionaries and float64, a formula a line."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array

from drsplat.base.arrays import Float, Int32, Integer
from drsplat.kernels.regions import Forest, MergeRule

Votes = Mapping[int, Mapping[int, float]]  # of a region, by view and mask
FEW = 0.001


def agglomerate(
    weights: csr_array,
    views: Int32[np.ndarray, " m"],
    embeddings: Float[np.ndarray, "m d"],
    edges: Integer[np.ndarray, "e 2"],
    thresholds: Sequence[float],
    rule: MergeRule,
) -> Forest:
    """As the native one; regions keep their first node's place."""
    grown = _Growing(weights, views, embeddings, rule)
    borders = {(a, b): grown.agreement(grown.votes[a], grown.votes[b]) for a, b in edges.tolist()}
    for number, threshold in enumerate(thresholds):
        for _ in range(rule.rounds if borders else 0):
            before = len(grown.votes)
            merged = grown.merge(borders, threshold)
            if len(grown.votes) == before:
                break
            borders = _merged_borders(borders, merged)
            if before - len(grown.votes) < FEW * before and number + 1 < len(thresholds):
                break
    return grown.forest()


class _Growing:
    """votes, nodes: of each region, by its number."""

    def __init__(self, weights: csr_array, views: np.ndarray, embeddings: np.ndarray, rule: MergeRule) -> None:
        self.rule, self.views, self.embeddings = rule, views, embeddings.astype(np.float64)
        self.totals = np.asarray(weights.sum(0, dtype=np.float64)).ravel()
        self.votes: list[dict[int, dict[int, float]]] = []
        for row in range(weights.shape[0]):
            part = slice(weights.indptr[row], weights.indptr[row + 1])
            self.votes.append(
                self._by_view(dict(zip(weights.indices[part].tolist(), weights.data[part].tolist(), strict=True)))
            )
        self.nodes = list(range(len(self.votes)))
        self.parents = [-1] * len(self.votes)
        self.kept: list[tuple[float, int, float, float, float]] = [(1.0, 1, _mass(v), 0.0, 0.0) for v in self.votes]

    def _by_view(self, shares: Mapping[int, float]) -> dict[int, dict[int, float]]:
        found: dict[int, dict[int, float]] = {}
        for mask, weight in sorted(shares.items()):
            found.setdefault(int(self.views[mask]), {})[mask] = float(weight)
        return found

    def agreement(self, one: Votes, other: Votes) -> np.ndarray:
        """sum_v c_v c'_v <p_v, p'_v> and sum_v c_v c'_v, with p = w / m and c = m / (m + soft)."""
        shared = seen = 0.0
        for view in one.keys() & other.keys():
            p, q = one[view], other[view]
            m, n = sum(p.values()), sum(q.values())
            known = (m + self.rule.soft) * (n + self.rule.soft)
            shared += sum(p[mask] * q[mask] for mask in p.keys() & q.keys()) / known
            seen += m * n / known
        return np.array([shared, seen])

    def pulled(self, agreement: np.ndarray) -> float:
        shared, seen = agreement
        return float((shared + self.rule.prior * self.rule.least) / (seen + self.rule.least))

    def distance(self, one: Votes, other: Votes) -> float:
        f, g = (
            np.sum([w * self.embeddings[mask] for shares in votes.values() for mask, w in shares.items()], axis=0)
            for votes in (one, other)
        )
        norms = float(np.linalg.norm(f) * np.linalg.norm(g))
        return max(0.0, 1 - float(np.dot(f, g)) / norms if norms > 0 else 1.0) / self.rule.unit

    def score(self, a: int, b: int, border: np.ndarray) -> float:
        rule, one, other = self.rule, self.votes[a], self.votes[b]
        along, over = self.pulled(border), self.pulled(self.agreement(one, other))
        return float(rule.local * along + (1 - rule.local) * over - rule.unlike * self.distance(one, other))

    def merge(self, borders: Mapping[tuple[int, int], np.ndarray], threshold: float) -> list[int]:
        """Merge neighbours that are each other's best, best first; return the new number of each region."""
        scores = {pair: self.score(*pair, border) for pair, border in borders.items()}
        best = [-np.inf] * len(self.votes)
        for (a, b), score in scores.items():
            best[a], best[b] = max(best[a], score), max(best[b], score)
        up, heaviest = list(range(len(self.votes))), list(range(len(self.votes)))
        for (a, b), score in sorted(scores.items(), key=lambda item: -item[1]):
            if score >= threshold and score + self.rule.tolerance >= max(best[a], best[b]):
                low, high = sorted((_root(up, a), _root(up, b)))
                ends = heaviest[_root(up, a)], heaviest[_root(up, b)]
                if low != high and (ends == (a, b) or self._agree(*ends, threshold)):
                    up[high] = low
                    heaviest[low] = ends[1] if self._mass(ends[1]) > self._mass(ends[0]) else ends[0]
        roots = sorted({_root(up, r) for r in range(len(up))})
        merged = [roots.index(_root(up, r)) for r in range(len(up))]
        self._replace([[r for r, new in enumerate(merged) if new == n] for n in range(len(roots))], threshold)
        return merged

    def _agree(self, one: int, other: int, threshold: float) -> bool:
        """Whether the heaviest regions on both sides of a chain agree by enough of the threshold."""
        return self.pulled(self.agreement(self.votes[one], self.votes[other])) >= self.rule.linked * threshold

    def _mass(self, region: int) -> np.float32:
        return np.float32(self.kept[self.nodes[region]][2])

    def _replace(self, groups: list[list[int]], threshold: float) -> None:
        votes, nodes = [], []
        for members in groups:
            if len(members) == 1:
                votes.append(self.votes[members[0]])
                nodes.append(self.nodes[members[0]])
                continue
            shares: dict[int, float] = {}
            for r in members:
                for of_view in self.votes[r].values():
                    for mask, weight in of_view.items():
                        shares[mask] = shares.get(mask, 0.0) + weight
            whole = self._by_view(shares)
            nodes.append(self._new_node(members, whole, threshold))
            votes.append(whole)
        self.votes, self.nodes = votes, nodes

    def _new_node(self, members: list[int], whole: Votes, threshold: float) -> int:
        node = len(self.parents)
        sizes = [self.kept[self.nodes[r]][1] for r in members]
        for r in members:
            self.parents[self.nodes[r]] = node
        size = sum(sizes)
        judged = size >= self.rule.smallest
        fit, spread = (self.fit(whole), self._spread(members, sizes)) if judged else (0.0, 0.0)
        self.parents.append(-1)
        self.kept.append((threshold, size, sum(self.kept[self.nodes[r]][2] for r in members), fit, spread))
        return node

    def _spread(self, members: list[int], sizes: list[int]) -> float:
        largest = members[int(np.argmax(sizes))]
        apart = [
            self.distance(self.votes[largest], self.votes[r])
            for r, size in zip(members, sizes, strict=True)
            if r != largest and size >= self.rule.smallest
        ]
        return max([0.0, *apart, *(self.kept[self.nodes[r]][4] for r in members)])

    def fit(self, votes: Votes) -> float:
        """Mean over views of the largest IoU with one of their masks, weighted by m / (m + far)."""
        total = seen = 0.0
        for shares in votes.values():
            m = sum(shares.values())
            best = max(w / (m + self.totals[mask] - w) for mask, w in shares.items())
            total += best * m / (m + self.rule.far)
            seen += m / (m + self.rule.far)
        return total / seen if seen else 0.0

    def forest(self) -> Forest:
        agreements, sizes, masses, fits, spreads = zip(*self.kept, strict=True)
        as_float = (np.array(values, np.float32) for values in (masses, fits, spreads))
        return Forest(
            np.array(self.parents, np.int32), np.array(agreements, np.float32), np.array(sizes, np.int32), *as_float
        )


def _mass(votes: Votes) -> float:
    return sum(w for shares in votes.values() for w in shares.values())


def _root(up: list[int], r: int) -> int:
    while up[r] != r:
        r = up[r]
    return r


def _merged_borders(
    borders: Mapping[tuple[int, int], np.ndarray], merged: Sequence[int]
) -> dict[tuple[int, int], np.ndarray]:
    found: dict[tuple[int, int], np.ndarray] = {}
    for (a, b), border in sorted(borders.items()):
        low, high = sorted((merged[a], merged[b]))
        if low != high:
            found[low, high] = found.get((low, high), 0.0) + border
    return dict(sorted(found.items()))
