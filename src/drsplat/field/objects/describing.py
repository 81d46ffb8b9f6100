"""Description of a forest's nodes as `Objects`: their boxes, masses, photos, masks and descriptors.

Linear in the weights of the evidence: rows of W are summed into nodes and these into those above, and no step is
nodes times Gaussians.

Descriptors are a few embeddings that say what a node looks like, by spherical k-means of those of its masks, all nodes
at once: one mean of a mug's front and back fits neither as well as two do.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import (
    Arrays,
    Doubles,
    Embeddings,
    Float32,
    Float64,
    FloatRows,
    Ids,
    Indices,
    Int64,
    OtherEmbeddings,
    OtherIds,
    OtherIndices,
    RowIds,
    Vector3,
)
from ...base.working import HERE, Held, Here, Work
from ...errors import InputError
from ...kernels import weighted_rows
from ...kernels.boxes import Boxes, boxes_of
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import Gaussians
from .. import LanguageField
from ..evidence.aggregation.entries import entry_rows
from ..evidence.evidence import Evidence, csr_of
from ..evidence.pieces import HeldRows
from ..forest import JOINED, MAX_DESCRIPTORS_PER_NODE, MAX_MASKS_PER_NODE, Objects, by_number, check_forest
from .choosing import Tree, pairs_above

Starts = Int64[np.ndarray, " T1"]

ROWS_AT_ONCE, NODES_AT_ONCE = 1 << 18, 128  # of nodes that are described
ROWS_SUMMED_AT_ONCE = 1 << 16
SHAPES = ("means", "quats", "scales", "opacities")
MIN_SHOWN_SHARE = 0.01  # of what the best photo of a node shows of it
MAX_MASKS_CLUSTERED = 64  # of a node, those of the largest weights
ALIKE_COSINE = 0.8  # what is as near as this to a centre needs none of its own
MIN_CLUSTER_SHARE = 0.05  # of a node's weight: masks with less together are left out
LLOYD_ROUNDS = 4  # after each new centre
ENTRIES_AT_ONCE = 4096


def describe(
    field: LanguageField, gaussians: Gaussians, tree: Tree, *, threads: int = 0, work: Work | None = None
) -> Objects:
    """Describe each node of a tree over the rows of a field. The result has the same bits at any `threads` and `work`.

    Nodes that no row belongs to, themselves or below them, are refused: they would be nowhere.

    Raises: InputError: the field was made without evidence, arrays that are no tree over its rows, or a node
    without rows. MismatchError: the field is of another scene.
    """
    field.check_scene(gaussians)
    if field.evidence is None:
        raise InputError("this field holds no evidence, which tells what belongs together: register again and keep it")
    if tree.node_of.shape != (len(field),):
        raise InputError(f"node_of: expected one node for each of {len(field)} rows, got {tree.node_of.shape}")
    check_forest(tree.node_of, tree.parents, tree.levels)
    inside, (order, begins) = _inside(tree.parents), by_number(tree.node_of, len(tree.parents))
    counts = (inside @ np.diff(begins)).astype(np.int64)
    if not counts.all():
        raise InputError(f"node {counts.argmin()} has no rows, neither of its own nor below it")
    work, evidence = work or Here(threads), field.evidence
    rows = HeldRows.of(evidence.weights, work)
    weights = _summed(rows, inside, (order, begins), work)
    scene = {name: getattr(gaussians, name) for name in SHAPES} | {
        "weights": weights.data, "columns": weights.indices, "starts": weights.indptr,
        "totals": rows.totals(), "views": evidence.masks.views, "embeddings": evidence.embeddings,
        "inside": inside.indices, "inside_starts": inside.indptr, "order": field.gaussian_ids[order], "begins": begins,
    }  # fmt: skip
    describing = Describing(work.hold(scene), rows.columns, field.up, gaussians.origin)
    found = [one.arrays for one in work(describing, _runs(counts, ROWS_AT_ONCE, NODES_AT_ONCE), "describing objects")]
    told: dict[str, Any] = {name: np.concatenate([one[name] for one in found]) for name in found[0]}
    starts: dict[str, Any] = {
        name: np.append(0, np.cumsum(told.pop(name))) for name in ("mask_starts", "descriptor_starts")
    }
    kept = tree.node_of >= 0
    own = np.bincount(tree.node_of[kept], gaussians.opacities[field.gaussian_ids[kept]], len(counts))
    return Objects(**tree._asdict(), masses=np.asarray(inside @ own, np.float32), **told, **starts)


@dataclass(frozen=True, eq=False)
class Describing:
    """Describes nodes: a `Part`. scene: shapes of Gaussians; (T, M) weights; (T, T) nodes inside, and their Gaussians.

    columns: M.
    """

    scene: Held
    columns: int
    up: Vector3 | None
    origin: Vector3

    def __call__(self, nodes: Indices, threads: int) -> Arrays:
        held = self.scene.arrays
        begins, embeddings, views = held["begins"], held["embeddings"], held["views"]
        weights = csr_of(held["starts"], held["columns"], held["weights"], self.columns)[nodes]
        inside = csr_of(held["inside_starts"], held["inside"], np.ones(len(held["inside"])), len(begins) - 1)[nodes]
        boxes = self._boxes(*_rows(inside, held["order"], begins), threads)
        masks = heaviest(weights, MAX_MASKS_PER_NODE)
        totals: Float64[np.ndarray, " T"] = weights.sum(axis=1)
        shares = masks.data / np.repeat(totals, np.diff(masks.indptr))
        descriptor_starts, vectors = descriptors(_exclusive(weights, held["totals"]), embeddings, threads=threads)
        return {
            "centers": boxes.center, "axes": boxes.axes, "extents": boxes.extent,
            "num_views": _num_views(weights, views), "mask_starts": np.diff(masks.indptr),
            "masks": masks.indices.astype(np.int32), "shares": shares.astype(np.float32),
            "descriptor_starts": np.diff(descriptor_starts), "descriptors": vectors,
        }  # fmt: skip

    def _boxes(self, starts: Int64[np.ndarray, " k1"], ids: Indices, threads: int) -> Boxes:
        """Return the box of what can be seen of each node (`scene.boxes.solid`), or of all of it where nothing can."""
        means, quats, scales, opacities = (self.scene.arrays[name] for name in SHAPES)
        colours = np.broadcast_to(np.float32(0), (len(means), 1, 3))
        gaussians = Gaussians(means, quats, scales, opacities, colours, origin=self.origin)
        nodes, count = np.repeat(np.arange(len(starts) - 1), np.diff(starts)), len(starts) - 1
        seen = opacities[ids] >= HAZE_OPACITY
        seen |= (np.bincount(nodes[seen], minlength=count) == 0)[nodes]
        counts = np.bincount(nodes[seen], minlength=count)
        return boxes_of(gaussians, np.append(0, np.cumsum(counts)), ids[seen], self.up, threads=threads)


@dataclass(frozen=True, eq=False)
class Summing:
    """Adds up the rows of W of nodes, without those below them: a `Part`. scene: rows in the `order` of nodes."""

    weights: HeldRows
    scene: Held

    def __call__(self, nodes: Indices, threads: int) -> Arrays:
        order, begins = self.scene.arrays["order"], self.scene.arrays["begins"]
        rows = np.concatenate([order[:0], *(order[begins[node] : begins[node + 1]] for node in nodes.tolist())])
        starts = np.append(0, np.cumsum(np.diff(begins)[nodes])).astype(np.int32)
        own = csr_of(starts, np.arange(len(rows), dtype=np.int32), np.ones(len(rows), np.float32), len(rows))
        summed = csr_array(own @ self.weights.rows(rows))
        return {"starts": np.diff(summed.indptr), "columns": summed.indices, "weights": summed.data}


def node_weights(evidence: Evidence, tree: Tree) -> csr_array:
    """Return (T, M) the summed weight of all rows of a node, those below it included, in each mask."""
    rows, by_node = HeldRows.of(evidence.weights, HERE), by_number(tree.node_of, len(tree.parents))
    return _summed(rows, _inside(tree.parents), by_node, HERE)


def joined(before: LanguageField, after: LanguageField, gaussians: Gaussians, *, threads: int = 0) -> Objects:
    """Return the objects of a field for the same field with more photos: the same nodes, as all photos show them.

    Gaussians that no photo showed before are in none. Raises: as `describe`; InputError: the first has no objects.
    """
    if before.objects is None:
        raise InputError("expected a field with objects")
    old = before.objects
    tree = Tree(_kept_nodes(before, after), old.parents, old.levels, old.sure)
    return replace(describe(after, gaussians, tree, threads=threads), votes=JOINED if old.votes else "")


def _kept_nodes(before: LanguageField, after: LanguageField) -> Ids:
    rows = before.rows_of(after.gaussian_ids)
    assert before.objects is not None
    return np.where(rows < 0, np.int32(-1), before.objects.node_of[rows])


def objects_during(whole: LanguageField, some: LanguageField, *, threads: int = 0) -> Objects:
    """Return the objects of a field for one made of some of its photos (`field_during`).

    Nodes, numbers, boxes and masks stay; rows are those of the smaller field, descriptors are of what its photos show.

    Raises: InputError: the first has no objects, the second no evidence.
    """
    if whole.objects is None or some.evidence is None:
        raise InputError("expected a field with objects, and one with evidence")
    objects, node_of = whole.objects, _kept_nodes(whole, some)
    weights = node_weights(some.evidence, Tree(node_of, objects.parents, objects.levels, objects.sure))
    totals = HeldRows.of(some.evidence.weights, HERE).totals()
    starts, vectors = descriptors(_exclusive(weights, totals), some.evidence.embeddings, threads=threads)
    return replace(objects, node_of=node_of, descriptor_starts=starts, descriptors=vectors)


def _inside(parents: Ids) -> csr_array:
    """Return (T, T): entry (t, s) is 1 where node s is t, or below it."""
    columns, rows = pairs_above(parents)
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(parents),) * 2)


def _summed(rows: HeldRows, inside: csr_array, by_node: tuple[np.ndarray, np.ndarray], work: Work) -> csr_array:
    """Return (T, M): the summed weight of all rows of a node in each mask. by_node: rows, and where nodes' begin."""
    order, begins = by_node
    counts = np.diff(begins)
    first = np.append(order, len(order))[begins[:-1]]  # nodes that are near in the scene are added up together
    nodes = np.argsort(first, kind="stable")
    runs = [nodes[run] for run in _runs(counts[nodes], ROWS_SUMMED_AT_ONCE, len(nodes))]
    summing = Summing(rows, work.hold({"order": order, "begins": begins}))
    parts = [one.arrays for one in work(summing, runs, "adding up objects")]
    lengths, columns, data = (np.concatenate([one[name] for one in parts]) for name in ("starts", "columns", "weights"))
    own = csr_of(np.append(0, np.cumsum(lengths)), columns, data, rows.columns)
    summed = csr_array(inside[:, nodes] @ own.astype(np.float64))
    summed.eliminate_zeros()
    summed.sort_indices()
    return summed


def _runs(counts: RowIds, most: int, many: int) -> list[np.ndarray]:
    """Cut the numbers of nodes into runs that have up to `most` rows, or one node, and up to `many` nodes."""
    ends, begins = np.cumsum(counts), [0]
    while begins[-1] < len(counts):
        begin = begins[-1]
        within = int(np.searchsorted(ends, ends[begin] - counts[begin] + most, side="right"))
        begins.append(min(max(within, begin + 1), begin + many, len(counts)))
    return [np.arange(begin, end) for begin, end in pairwise(begins)] or [np.arange(0)]


def _rows(inside: csr_array, order: RowIds, begins: Starts) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of some nodes and of those below them, in CSR form (starts, rows).

    order, begins: all rows in the order of their nodes, and where those of each begin.
    """
    lengths = np.diff(begins)[inside.indices]
    skipped = begins[inside.indices] - (np.cumsum(lengths) - lengths)
    rows = order[np.arange(lengths.sum()) + np.repeat(skipped, lengths)].astype(np.int64)
    return np.append(0, np.cumsum(inside @ np.diff(begins))).astype(np.int64), rows


def _num_views(weights: csr_array, views: Ids) -> OtherIds:
    """Return the photos that show more than a sliver of each node."""
    shown = shown_in_photos(weights, views)
    nodes = entry_rows(shown)
    most = np.zeros(shown.shape[0])
    np.maximum.at(most, nodes, shown.data)
    return np.bincount(nodes[shown.data > MIN_SHOWN_SHARE * most[nodes]], minlength=shown.shape[0]).astype(np.int32)


def shown_in_photos(weights: csr_array, views: Ids) -> csr_array:
    """Return (T, V) the weight of each node in each photo. weights: (T, M) in each mask. views: photo of each mask."""
    places = np.arange(len(views)), views
    of_view = csr_array((np.ones(len(views)), places), shape=(len(views), int(views.max(initial=-1)) + 1))
    return csr_array(weights @ of_view)


def _exclusive(weights: csr_array, totals: Doubles) -> csr_array:
    """Return R_tj q_tj: the weight of node t in mask j, times the share of the mask's weight that lies in the node.

    A mask of the whole table says little of the mug on it. totals: the weight of each mask.
    """
    exclusive = weights.data * (weights.data / np.maximum(totals[weights.indices], weights.data))
    return csr_array((exclusive, weights.indices, weights.indptr), shape=weights.shape)


def descriptors(weights: csr_array, embeddings: Embeddings, *, threads: int = 0) -> tuple[Starts, OtherEmbeddings]:
    """Return up to four unit vectors for each row of `weights` (T, M), as row starts and vectors, the heaviest first.

    The first centre is the weighted mean; a further one starts from the mask that is served worst, weight times
    (1 - cosine), as long as one is unlike all centres. The same bits at any number of threads.
    """
    clusters = _Clusters(heaviest(weights, MAX_MASKS_CLUSTERED), embeddings, threads)
    labels = np.zeros(clusters.weights.nnz, np.int64)
    part = np.arange(len(labels))  # entries of rows that may need more
    for count in range(1, MAX_DESCRIPTORS_PER_NODE):
        cosines = clusters.cosines(labels, part, count).max(axis=1, initial=-1).astype(np.float64)
        served = np.where(cosines < ALIKE_COSINE, clusters.weights.data[part] * (1 - cosines), 0)
        rows, most = clusters.rows[part], np.zeros(weights.shape[0])
        np.maximum.at(most, rows, served)
        (worst,) = np.nonzero((served > 0) & (served == most[rows]))  # among those that are unlike all centres
        far = part[worst[np.diff(rows[worst], prepend=-1) > 0]]
        needing = np.zeros(weights.shape[0], bool)
        needing[clusters.rows[far]] = True
        part = part[needing[clusters.rows[part]]]
        labels[far] = count
        for _ in range(LLOYD_ROUNDS):  # move entries to the nearest centre, the first of equal ones
            nearest = clusters.cosines(labels, part, count + 1).argmax(axis=1)
            if (nearest == labels[part]).all():
                break
            labels[part] = nearest
    return clusters.centers(labels)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Up to MAX_DESCRIPTORS_PER_NODE clusters in each row. weights: (T, M), with the entries that are put into them.

    labels: the cluster of each entry, counted in its row. part: numbers of some of the entries.
    """

    weights: csr_array
    embeddings: Embeddings
    threads: int

    @cached_property
    def rows(self) -> OtherIndices:
        return entry_rows(self.weights)

    def means(self, labels: OtherIndices) -> Float32[np.ndarray, "T k D"]:
        """Return the unit mean of each cluster, zero where it has no entries or they cancel out."""
        clusters = self.rows * MAX_DESCRIPTORS_PER_NODE + labels
        order = np.argsort(clusters, kind="stable")
        count = self.weights.shape[0] * MAX_DESCRIPTORS_PER_NODE
        starts = np.append(0, np.cumsum(np.bincount(clusters, minlength=count)))
        data = self.weights.data[order].astype(np.float32)
        means = weighted_rows(
            starts, self.weights.indices[order], data, self.embeddings, 0, count, threads=self.threads
        )
        return means.reshape(-1, MAX_DESCRIPTORS_PER_NODE, means.shape[1])

    def cosines(self, labels: OtherIndices, part: Indices, count: int) -> FloatRows:
        """Return the cosines of the entries of `part` with the first `count` centres of their rows, -1 with empty ones.

        BLAS is avoided: its bits depend on the number of its threads.
        """
        means = self.means(labels)
        filled = np.asarray(means.any(axis=2))
        cosines = np.empty((len(part), count), np.float32)
        for begin in range(0, len(part), ENTRIES_AT_ONCE):
            entries = part[begin : begin + ENTRIES_AT_ONCE]
            rows, own = self.rows[entries], self.embeddings[self.weights.indices[entries]]
            for k in range(count):
                row_cosines = np.einsum("ed,ed->e", own, means[rows, k])
                cosines[begin : begin + ENTRIES_AT_ONCE, k] = np.where(filled[rows, k], row_cosines, -1)
        return cosines

    def centers(self, labels: OtherIndices) -> tuple[Starts, Embeddings]:
        """Return the row starts and unit means, the heaviest cluster of each row first, without specks."""
        means = self.means(labels)
        shape = means.shape[:2]
        clusters = self.rows * MAX_DESCRIPTORS_PER_NODE + labels
        mass = np.bincount(clusters, self.weights.data, shape[0] * shape[1]).reshape(shape)
        mass[~means.any(axis=2) | (mass < MIN_CLUSTER_SHARE * mass.sum(axis=1, keepdims=True))] = 0
        order = np.argsort(-mass, axis=1, kind="stable")
        sorted_means = np.take_along_axis(means, order[..., None], axis=1)
        filled = np.take_along_axis(mass, order, axis=1) > 0
        return np.append(0, np.cumsum(filled.sum(axis=1))), np.asarray(sorted_means[filled])


def heaviest(matrix: csr_array, most: int) -> csr_array:
    """Return up to `most` entries of each row, the heaviest first, of equal ones the first first."""
    parts = [np.empty(0, np.int64)]
    for begin, end in pairwise(matrix.indptr.tolist()):
        light = -matrix.data[begin:end]
        bound = np.partition(light, most)[most] if len(light) > most else np.inf  # few of a long row are sorted
        some = np.flatnonzero(light <= bound)
        parts.append(begin + some[np.argsort(light[some], kind="stable")[:most]])
    kept, starts = np.concatenate(parts), np.append(0, np.cumsum(np.minimum(np.diff(matrix.indptr), most)))
    return csr_of(starts, matrix.indices[kept], matrix.data[kept], matrix.shape[1])
