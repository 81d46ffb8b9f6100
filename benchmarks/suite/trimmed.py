"""Values of whole objects from their masks, instead of from their Gaussians: means, trimmed means, and clusters.

Node t has weight w_tj in mask j: what lies in the mask of all its Gaussians, times the share of the mask that lies in
the node. Nothing here is Gaussians times dimensions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.sparse import csr_array

from drsplat import LanguageField
from drsplat.base.working import HERE
from drsplat.field.evidence.pieces import HeldRows
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import _exclusive, heaviest, node_weights
from drsplat.query.contrast import Contrast
from drsplat.query.wholes import OBJECT_TRUST

TRIMS = (0.2, 0.4)  # share of a node's weight that is left out
ROUNDS = 3
MOST = 64  # masks of a node, those of the largest weights
CLUSTER_SHARE = 0.2  # of a node's weight, that a descriptor needs to speak for it


@dataclass(frozen=True, eq=False)
class Wholes:
    """Other values for the objects of a field, whose plain rows are contrasted by `known`."""

    field: LanguageField
    known: Contrast

    @cached_property
    def weights(self) -> csr_array:
        """w of all nodes and masks, the heaviest of each node."""
        objects, evidence = self.field.objects, self.field.evidence
        assert objects is not None
        assert evidence is not None
        tree = Tree(objects.node_of, objects.parents, objects.levels, objects.sure)
        totals = HeldRows.of(evidence.weights, HERE).totals()
        return heaviest(_exclusive(node_weights(evidence, tree), totals), MOST)

    @cached_property
    def described(self) -> dict[str, Contrast]:
        """The list of words at each kind of mean of all nodes; the unit means are kept beside it in `features`."""
        return {name: self.known.at(rows) for name, rows in self.features.items()}

    @cached_property
    def features(self) -> dict[str, Float32[np.ndarray, "T D"]]:
        assert self.field.evidence is not None
        embeddings = self.field.evidence.embeddings
        kinds = {"mean": 0.0} | {f"trimmed {share:.0%}": share for share in TRIMS}
        return {name: trimmed_means(self.weights, embeddings, share) for name, share in kinds.items()}

    @cached_property
    def at_masks(self) -> Contrast:
        assert self.field.evidence is not None
        return self.known.at(self.field.evidence.embeddings)

    def answered(
        self, query: Float32[np.ndarray, " D"], values: Float32[np.ndarray, " r"]
    ) -> Iterator[tuple[str, Float32[np.ndarray, " r"]]]:
        """Yield values per row by the value of its object, or of its piece of it where that is higher.

        query: unit vector. values: relevancies of the plain rows.
        """
        objects, evidence = self.field.objects, self.field.evidence
        assert objects is not None
        assert evidence is not None
        things, pieces = objects.thing_of(), objects.piece_of()
        kinds = {name: _relevancy(self.described[name], query, rows) for name, rows in self.features.items()}
        masks = _relevancy(self.at_masks, query, evidence.embeddings)
        kinds["masks 20%"] = trimmed_values(self.weights, masks, 0.2).astype(np.float32)
        of_clusters = _relevancy(self.at_descriptors, query, objects.descriptors)
        kinds[f"clusters {CLUSTER_SHARE:.0%}"] = best_clusters(of_clusters, self.cluster_shares, self.starts)
        for name, of_node in kinds.items():
            spoken = np.append(of_node, -1)[np.where(things >= 0, objects.things[things], -1)]
            spoken = np.maximum(spoken, np.append(of_node, -1)[pieces])
            mixed = np.float32(1 - OBJECT_TRUST) * values + np.float32(OBJECT_TRUST) * spoken
            yield name, np.where(things >= 0, mixed, values)

    @property
    def starts(self) -> Int64[np.ndarray, " T1"]:
        assert self.field.objects is not None
        return self.field.objects.descriptor_starts

    @cached_property
    def at_descriptors(self) -> Contrast:
        assert self.field.objects is not None
        return self.known.at(self.field.objects.descriptors)

    @cached_property
    def cluster_shares(self) -> Float64[np.ndarray, " P"]:
        """Per descriptor the share of its node's weight in the masks that are nearer to it than to the others."""
        objects, evidence = self.field.objects, self.field.evidence
        assert objects is not None
        assert evidence is not None
        shares = np.zeros(len(objects.descriptors))
        for node in np.flatnonzero(np.diff(self.starts)):
            own = slice(self.starts[node], self.starts[node + 1])
            part = slice(self.weights.indptr[node], self.weights.indptr[node + 1])
            weight, masks = self.weights.data[part], evidence.embeddings[self.weights.indices[part]]
            nearest = (masks @ objects.descriptors[own].T).argmax(1)
            shares[own] = np.bincount(nearest, weight, own.stop - own.start) / max(weight.sum(), 1e-12)
        return shares


def _relevancy(known: Contrast, query: np.ndarray, rows: np.ndarray) -> Float32[np.ndarray, " m"]:
    found = known.relevancy(query, rows @ query)
    assert found is not None
    return found


def best_clusters(
    values: Float32[np.ndarray, " P"], shares: Float64[np.ndarray, " P"], starts: Int64[np.ndarray, " T1"]
) -> Float32[np.ndarray, " T"]:
    """Return each node's best value of descriptors of enough weight, its first's where none has it; -1 without any."""
    best = np.full(len(starts) - 1, -1, np.float32)
    (some,) = np.nonzero(np.diff(starts))
    speaking = shares >= CLUSTER_SHARE
    speaking[starts[some]] |= ~np.logical_or.reduceat(speaking, starts[some]) if len(some) else False
    if len(some):
        best[some] = np.maximum.reduceat(np.where(speaking, values, np.float32(-1)), starts[some])
    return best


def trimmed_means(
    weights: csr_array, embeddings: Float32[np.ndarray, "M D"], share: float
) -> Float32[np.ndarray, "T D"]:
    """Return unit weighted means without the masks least like them, which have at most `share` of the weight.

    From the mean of all, in ROUNDS: the masks of the lowest cosines with the last mean are left out of the next.
    """
    result = np.zeros((weights.shape[0], embeddings.shape[1]), np.float32)
    for node in range(weights.shape[0]):
        part = slice(weights.indptr[node], weights.indptr[node + 1])
        own, weight = embeddings[weights.indices[part]].astype(np.float64), weights.data[part]
        mean = weight @ own
        for _ in range(ROUNDS if share else 0):
            order = np.argsort(own @ mean, kind="stable")
            kept = order[np.cumsum(weight[order]) > share * weight.sum()]
            mean = weight[kept] @ own[kept]
        result[node] = mean / max(np.linalg.norm(mean), 1e-12)
    return result


def trimmed_values(weights: csr_array, values: Float32[np.ndarray, " M"], share: float) -> Float64[np.ndarray, " T"]:
    """Return weighted means of each node's values, `share` of the weight left out at either end."""
    result = np.zeros(weights.shape[0])
    for node in range(weights.shape[0]):
        part = slice(weights.indptr[node], weights.indptr[node + 1])
        own, weight = values[weights.indices[part]].astype(np.float64), weights.data[part]
        order = np.argsort(own, kind="stable")
        upto = np.cumsum(weight[order]) / max(weight.sum(), 1e-12)
        inside = np.clip(np.minimum(upto, 1 - share) - np.maximum(np.append(0, upto[:-1]), share), 0, None)
        result[node] = inside @ own[order] / max(inside.sum(), 1e-12)
    return result
