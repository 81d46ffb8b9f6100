"""The twin of `merged_regions` and `merge_order`, for any likelihood: regions become one, the surest pair first."""

import heapq
from collections.abc import Callable, Iterator

import numpy as np

from drsplat.base.arrays import DoubleRows, Doubles, Float64, Indices, Int64
from drsplat.kernels.photo_regions import AREA, AROUND, LENGTH, RegionGraph
from drsplat.photos.models.graph.segmenter import MergeRule

from .photo_features import pair_features

Likelihood = Callable[[Float64[np.ndarray, "e f"]], Float64[np.ndarray, " e"]]


def likelihood(rule: MergeRule, features: DoubleRows) -> Doubles:
    """Return the likelihood of each pair, 0 to 1, in six digits: a product's last bits depend on the processor."""
    inner = np.tanh(np.clip((features - rule.center) / rule.width, -5, 5) @ rule.hidden + rule.hidden_bias)
    return np.round(1 / (1 + np.exp(-(inner @ rule.output + rule.output_bias))), 6)


class Merging:
    """A graph of regions while it shrinks. A union goes by the lower of its two numbers.

    owner: the number that each region goes by now, to be followed up to one that owns itself.
    """

    def __init__(self, graph: RegionGraph, likelihood: Likelihood) -> None:
        self.sums, self.boxes = graph.sums.copy(), graph.boxes.copy()
        self.borders = graph.borders.copy()
        self.owner = np.arange(len(self.sums))
        self.node = list(range(len(self.owner)))
        self.order: list[tuple[int, int]] = []  # of unions, whose numbers come after those of the regions
        self._pixels, self._likelihood = graph.pixels, likelihood
        self._near: list[dict[int, int]] = [{} for _ in self.owner]  # neighbour: row of borders
        for row, (a, b) in enumerate(graph.pairs.tolist()):
            self._near[a][b] = self._near[b][a] = row
        self._born = [0] * len(self.borders)  # a pair that is scored anew outdates its older scores
        self._queue: list[tuple[float, int, int, int]] = []

    def merge_above(self, threshold: float) -> None:
        """Merge the likeliest pair, of equal ones the first, until none is above the threshold."""
        self._score_all(threshold)
        while self._queue:
            _, a, b, born = heapq.heappop(self._queue)
            row = self._near[a].get(b)
            if row is not None and self._born[row] == born:
                self._union(a, b)
                self._score(a, threshold)

    def merge_small(self, least_area: float, least_width: float = 0.0) -> None:
        """Regions with fewer pixels or narrower, smallest first, go to the likeliest neighbour each.

        A region is as wide as a long strip of its area and border to others.
        """
        areas = self.sums[:, AREA].tolist()
        queue = [(area, i) for i, area in enumerate(areas) if self.owner[i] == i]
        heapq.heapify(queue)
        while queue:
            area, i = heapq.heappop(queue)
            if self.owner[i] != i or self.sums[i, AREA] != area or not self._near[i]:
                continue
            if area >= least_area and 2 * area >= least_width * self.sums[i, AROUND]:
                continue
            others, scores = self._scored(i)
            best = min(zip((-scores).tolist(), others, strict=True))[1]
            self._union(min(i, best), max(i, best))
            heapq.heappush(queue, (float(self.sums[min(i, best), AREA]), min(i, best)))

    def labels(self) -> Indices:
        """The new number of each region, from 0 in the order of the lowest region of each."""
        for i in range(len(self.owner)):  # owners are lower, so they are final already
            self.owner[i] = self.owner[self.owner[i]]
        return np.unique(self.owner, return_inverse=True)[1].astype(np.int64)

    def features(self, a: Int64[np.ndarray, " e"], b: Int64[np.ndarray, " e"]) -> np.ndarray:
        """pair_features of these pairs, which touch."""
        rows = [self._near[i][j] for i, j in zip(a.tolist(), b.tolist(), strict=True)]
        return self._features(np.stack([a, b]), np.array(rows, np.int64))

    def touching(self) -> Int64[np.ndarray, "e 2"]:
        """Pairs that touch now, lower number first, in order."""
        return np.array(sorted(self._pairs()), np.int64).reshape(-1, 2)

    def _pairs(self) -> Iterator[tuple[int, int]]:
        for a, near in enumerate(self._near):
            yield from ((a, b) for b in near if a < b)

    def _features(self, ends: Int64[np.ndarray, "2 e"], rows: Int64[np.ndarray, " e"]) -> Float64[np.ndarray, "e f"]:
        return pair_features(self.sums[ends], self.boxes[ends], self.borders[rows], self._pixels)

    def _score_all(self, threshold: float) -> None:
        pairs = self.touching()
        if len(pairs):
            scores = self._likelihood(self.features(pairs[:, 0], pairs[:, 1]))
            for (a, b), score in zip(pairs.tolist(), scores.tolist(), strict=True):
                self._push(a, b, score, threshold)

    def _scored(self, i: int) -> tuple[list[int], Float64[np.ndarray, " e"]]:
        """Neighbours of a region and how likely each belongs to it."""
        others, rows = list(self._near[i]), np.array(list(self._near[i].values()), np.int64)
        ends = np.sort([np.full(len(others), i), np.array(others, np.int64)], axis=0)
        return others, self._likelihood(self._features(ends, rows))

    def _score(self, i: int, threshold: float) -> None:
        if self._near[i]:
            others, scores = self._scored(i)
            for other, score in zip(others, scores.tolist(), strict=True):
                self._push(min(i, other), max(i, other), score, threshold)

    def _push(self, a: int, b: int, score: float, threshold: float) -> None:
        row = self._near[a][b]
        self._born[row] += 1
        if score > threshold:
            heapq.heappush(self._queue, (-score, a, b, self._born[row]))

    def _union(self, a: int, b: int) -> None:
        """b becomes part of a."""
        self.order.append((self.node[a], self.node[b]))
        self.node[a] = len(self.owner) + len(self.order) - 1
        between = self._near[a].pop(b)
        del self._near[b][a]
        self.sums[a] += self.sums[b]
        self.sums[a, AROUND] -= 2 * self.borders[between, LENGTH]
        self.boxes[a] = np.minimum(self.boxes[a], self.boxes[b])
        self.owner[b] = a
        for other, row in self._near[b].items():
            del self._near[other][b]
            if other in self._near[a]:
                self.borders[self._near[a][other]] += self.borders[row]
            else:
                self._near[a][other] = self._near[other][a] = row
        self._near[b] = {}
