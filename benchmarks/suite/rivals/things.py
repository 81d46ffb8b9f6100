"""Other rules that make things of the same masks, as far as they are published, on weights instead of depth."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, Integer
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from drsplat.field.evidence.evidence import Evidence
from drsplat.field.objects.block_nodes import neighbours

NONE = -1
Labels = Int64[np.ndarray, " r"]


class Agreement(NamedTuple):
    """MaskClustering's numbers, and gamma: the share of a view's weight above which a row lies in one mask there."""

    gamma: float = 0.5
    visible: float = 0.3
    many: int = 500
    contained: float = 0.8
    split: float = 0.3
    consensus: float = 0.9
    seen_in: float = 0.5


class Alike(NamedTuple):
    """LightSplat's thresholds, of which none is published."""

    iou: float
    cosine: float
    smallest: int


def mask_clustering(evidence: Evidence, means: Float32[np.ndarray, "r 3"], rule: Agreement) -> Labels:
    """Per row its thing, -1 for none: masks are one where most views that see both hold both in one mask.

    Source: MaskClustering, Sec. 3, and the numbers of its released configuration.
    """
    views = evidence.masks.views
    member = csr_array(dominant(evidence, rule.gamma))
    observed, contained = _observers(member, views, rule)
    kept = np.flatnonzero(observed[np.arange(len(views)), views])  # under-segmented masks do not see themselves
    clusters = _by_consensus(observed[kept], contained[np.ix_(kept, kept)], rule.consensus)
    group = np.full(len(views), NONE)
    group[kept] = np.where(np.bincount(clusters)[clusters] > 1, clusters, NONE)
    return in_space(_lying_in(evidence, member, group, rule.seen_in), means)


def light_splat(evidence: Evidence, rule: Alike) -> Labels:
    """Per row its thing, -1 for none: masks are one where their rows and their embeddings are alike, chained.

    Source: LightSplat, as far as it is published.
    """
    member = dominant(evidence, 0.0)
    shared = (member.T @ member).toarray()
    sizes = np.diag(shared)
    ious = shared / np.maximum(sizes[:, None] + sizes - shared, 1)
    kept = np.flatnonzero(sizes >= rule.smallest)
    alike = (ious > rule.iou) & (evidence.embeddings @ evidence.embeddings.T > rule.cosine)
    group = np.full(len(sizes), NONE)
    group[kept] = connected_components(csr_array(alike[np.ix_(kept, kept)]), directed=False)[1]
    weights = csr_array(evidence.weights @ _one_hot(group))
    return _largest(weights)


@lru_cache(maxsize=64)  # many rules are tried on the same rooms
def dominant(evidence: Evidence, gamma: float) -> csr_array:
    """Rows x masks: 1 for the mask that has the most of a row's weight in a view, where it is `gamma` of it or more."""
    weights, views = evidence.weights.tocoo(), evidence.masks.views
    keys = weights.row.astype(np.int64) * (int(views.max(initial=0)) + 1) + views[weights.col]
    order = np.lexsort((-weights.data, keys))
    keys, columns, rows, data = keys[order], weights.col[order], weights.row[order], weights.data[order]
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    if not len(starts):
        return csr_array(evidence.weights.shape, dtype=np.float32)
    firm = data[starts] >= gamma * np.add.reduceat(data, starts)
    firm &= data[starts] > 0
    chosen = starts[firm]
    ones = np.ones(len(chosen), np.float32)
    return csr_array((ones, (rows[chosen], columns[chosen])), shape=evidence.weights.shape)


def in_space(labels: Labels, means: Float32[np.ndarray, "r 3"]) -> Labels:
    """Things apart where their rows do not hang together."""
    pairs = neighbours(means)
    pairs = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    near = coo_array((np.ones(len(pairs), np.int8), tuple(pairs.T)), shape=(len(labels), len(labels)))
    return np.where(labels >= 0, connected_components(near, directed=False)[1], NONE)


def sureness(evidence: Evidence, labels: Labels) -> Float64[np.ndarray, " k"]:
    """Per label how well masks fit it: the mean, over the views that see it, of the IoU with the mask most like it."""
    views = evidence.masks.views
    shared = (_one_hot(labels).T @ evidence.weights).toarray()
    by_view = shared @ _one_hot(views).toarray()
    ious = shared / np.maximum(by_view[:, views] + evidence.weights.sum(0) - shared, 1e-12)
    best = np.zeros(by_view.shape)
    np.maximum.at(best.T, views, ious.T)
    seen = by_view > by_view.max(1, keepdims=True, initial=0) / 100
    return np.asarray((best * seen).sum(1) / np.maximum(seen.sum(1), 1))


def _observers(
    member: csr_array, views: Integer[np.ndarray, " m"], rule: Agreement
) -> tuple[Bool[np.ndarray, "m v"], Bool[np.ndarray, "m m"]]:
    """Which views see a mask whole, and which masks hold it. Those split in too many views are in none."""
    shared = (member.T @ member).toarray()
    sizes, of_view = np.diag(shared), _one_hot(views).toarray() > 0
    labelled = shared @ of_view
    visible = (labelled >= rule.visible * sizes[:, None]) | (labelled >= rule.many)
    visible &= labelled > 0
    holds = (shared > rule.contained * labelled[:, views]) & visible[:, views]
    observed = (holds.astype(np.float32) @ of_view) > 0
    split = (visible & ~observed).sum(1) > rule.split * np.maximum(visible.sum(1), 1)
    dropped = split | ~visible.any(1)
    for mask in np.flatnonzero(dropped):
        observed[holds[:, mask], views[mask]] = False
        holds[:, mask] = False
    observed[dropped], holds[dropped] = False, False
    return observed, holds


def _by_consensus(
    observed: Bool[np.ndarray, "m v"], contained: Bool[np.ndarray, "m m"], least: float
) -> Int64[np.ndarray, " m"]:
    """The cluster of each mask; pairs that many views see are merged first."""
    seen, held = observed.astype(np.float32), contained.astype(np.float32)
    cluster = np.arange(len(seen))
    together = seen @ seen.T
    counts = together[together > 0]
    for quantile in range(95, -5, -5) if len(counts) else ():
        enough = float(np.percentile(counts, quantile))
        if enough <= 1 and quantile < 50:
            break
        observers = seen @ seen.T
        edges = (held @ held.T >= least * (observers + 1e-7)) & (observers >= max(enough, 1))
        count, merged = connected_components(csr_array(edges), directed=False)
        one_hot = _one_hot(merged, count).T
        seen, held = (np.minimum(one_hot @ rows, 1) for rows in (seen, held))
        cluster = merged[cluster]
    return cluster


def _lying_in(evidence: Evidence, member: csr_array, group: Int64[np.ndarray, " m"], least: float) -> Labels:
    """Per row the group whose masks it lies in most, of those that hold it in most of their views that see it."""
    views = evidence.masks.views
    of_group, of_view = _one_hot(group), _one_hot(views)
    in_views = csr_array((of_view.T @ of_group) > 0).astype(np.float32)
    held = csr_array(member @ of_group).tocoo()
    seen = (member @ of_view) @ in_views
    often = held.data > least * np.asarray(seen[held.row, held.col])
    row, col = held.row[often], held.col[often]
    weights = csr_array(evidence.weights @ of_group)
    chosen = csr_array((np.asarray(weights[row, col]), (row, col)), shape=weights.shape)
    return _largest(chosen)


def _largest(weights: csr_array) -> Labels:
    """Per row the column of its largest weight, -1 without any."""
    best = np.asarray(weights.argmax(1)).ravel().astype(np.int64)
    return np.where(np.diff(weights.indptr) > 0, best, NONE)


def _one_hot(labels: Integer[np.ndarray, " n"], count: int | None = None) -> csr_array:
    """(n, labels), no entry for -1."""
    (known,) = np.nonzero(labels >= 0)
    shape = (len(labels), int(labels.max(initial=-1)) + 1 if count is None else count)
    return csr_array((np.ones(len(known), np.float32), (known, labels[known])), shape=shape)
