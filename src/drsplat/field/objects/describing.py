"""Description of a forest's nodes as `Objects`: their boxes, masses, photos, masks and descriptors.

Linear in the weights of the evidence: rows of W are summed into nodes and these into those above, and no step is
nodes times Gaussians.

Descriptors are a few embeddings that say what a node looks like, by spherical k-means of those of its masks, all nodes
at once: one mean of a mug's front and back fits neither as well as two do.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float32, Float64, Int32, Int64
from ...errors import InputError
from ...kernels import weighted_rows
from ...kernels.boxes import Boxes, boxes_of
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import Gaussians
from .. import LanguageField
from ..evidence.aggregation.entries import entry_rows, row_chunks
from ..evidence.evidence import Evidence
from ..forest import JOINED, MAX_DESCRIPTORS_PER_NODE, MAX_MASKS_PER_NODE, Objects, check_forest
from .choosing import Tree, pairs_above

Entries = Int64[np.ndarray, " e"]
Starts = Int64[np.ndarray, " T1"]
NodeOfRow = Int32[np.ndarray, " R"]

ROWS_AT_ONCE = 1 << 20
NO_BOXES = Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)))
MIN_SHOWN_SHARE = 0.01  # of what the best photo of a node shows of it
MAX_MASKS_CLUSTERED = 64  # of a node, those of the largest weights
ALIKE_COSINE = 0.8  # what is as near as this to a centre needs none of its own
MIN_CLUSTER_SHARE = 0.05  # of a node's weight: masks with less together are left out
LLOYD_ROUNDS = 4  # after each new centre
ENTRIES_AT_ONCE = 4096


def describe(field: LanguageField, gaussians: Gaussians, tree: Tree, *, threads: int = 0) -> Objects:
    """Describe each node of a tree over the rows of a field. The result has the same bits at any `threads`.

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
    inside = _members(tree.node_of, tree.parents)
    weights = _weights(field.evidence, inside, tree.node_of)
    exclusive = _exclusive(weights, field.evidence)
    return Objects(
        *tree,
        *_boxes(field, gaussians, inside, tree.node_of, threads),
        _masses(field, gaussians, inside, tree.node_of),
        _num_views(weights, field.evidence),
        *_masks(weights),
        *descriptors(exclusive, field.evidence.embeddings, threads=threads),
    )


def node_weights(evidence: Evidence, tree: Tree) -> csr_array:
    """Return (T, M) the summed weight of all rows of a node, those below it included, in each mask."""
    return _weights(evidence, _inside(tree.parents), tree.node_of)


def joined(before: LanguageField, after: LanguageField, gaussians: Gaussians, *, threads: int = 0) -> Objects:
    """Return the objects of a field for the same field with more photos: the same nodes, as all photos show them.

    Gaussians that no photo showed before are in none. Raises: as `describe`; InputError: the first has no objects.
    """
    if before.objects is None:
        raise InputError("expected a field with objects")
    old = before.objects
    tree = Tree(_kept_nodes(before, after), old.parents, old.levels, old.sure)
    return replace(describe(after, gaussians, tree, threads=threads), votes=JOINED if old.votes else "")


def _kept_nodes(before: LanguageField, after: LanguageField) -> NodeOfRow:
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
    weights = _weights(some.evidence, _inside(objects.parents), node_of)
    starts, vectors = descriptors(_exclusive(weights, some.evidence), some.evidence.embeddings, threads=threads)
    return replace(objects, node_of=node_of, descriptor_starts=starts, descriptors=vectors)


def _members(node_of: NodeOfRow, parents: Int32[np.ndarray, " T"]) -> csr_array:
    """Return `_inside`, checked. Raises: InputError: a node without rows."""
    inside, count = _inside(parents), len(parents)
    empty = np.flatnonzero(inside @ np.bincount(node_of[node_of >= 0], minlength=count) == 0)
    if len(empty):
        raise InputError(f"node {empty[0]} has no rows, neither of its own nor below it")
    return inside


def _inside(parents: Int32[np.ndarray, " T"]) -> csr_array:
    """Return (T, T): entry (t, s) is 1 where node s is t, or below it."""
    columns, rows = pairs_above(parents)
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(parents),) * 2)


def _weights(evidence: Evidence, inside: csr_array, node_of: NodeOfRow) -> csr_array:
    """Return (T, M): the summed weight of all rows of a node in each mask."""
    (rows,) = np.nonzero(node_of >= 0)
    place = node_of[rows].astype(np.int32), rows.astype(np.int32)  # of the kind of W's, which SciPy else copies
    own = csr_array((np.ones(len(rows), np.float32), place), shape=(inside.shape[0], len(node_of)))
    summed = inside @ (own @ evidence.weights).astype(np.float64)
    summed.eliminate_zeros()
    summed.sort_indices()
    return csr_array(summed)


def _boxes(field: LanguageField, gaussians: Gaussians, inside: csr_array, node_of: NodeOfRow, threads: int) -> Boxes:
    """Return the box of what can be seen of each node (`scene.boxes.solid`), or of all of it where nothing can.

    Nodes come in batches, so that memory is that of ROWS_AT_ONCE rows, or of the largest node.
    """
    order = np.argsort(node_of, kind="stable")
    begins = np.searchsorted(node_of[order], np.arange(inside.shape[0] + 1))
    rows_before = np.append(0, np.cumsum(inside @ np.diff(begins)))
    stops = np.unique(np.searchsorted(rows_before, np.arange(0, rows_before[-1] + ROWS_AT_ONCE, ROWS_AT_ONCE)))
    stops = np.unique(np.append(np.minimum(stops, inside.shape[0]), [0, inside.shape[0]]))
    parts = [
        _boxes_of_some(field, gaussians, *_rows(csr_array(inside[begin:end]), order, begins), threads)
        for begin, end in pairwise(stops.tolist())
    ]
    return Boxes(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True))) if parts else NO_BOXES


def _boxes_of_some(
    field: LanguageField, gaussians: Gaussians, starts: Starts, rows: Entries,
    threads: int,
) -> Boxes:  # fmt: skip
    nodes = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    ids = field.gaussian_ids[rows].astype(np.int64)
    seen = gaussians.opacities[ids] >= HAZE_OPACITY
    seen |= (np.bincount(nodes[seen], minlength=len(starts) - 1) == 0)[nodes]
    counts = np.bincount(nodes[seen], minlength=len(starts) - 1)
    return boxes_of(gaussians, np.append(0, np.cumsum(counts)), ids[seen], field.up, threads=threads)


def _rows(inside: csr_array, order: Int64[np.ndarray, " R"], begins: Starts) -> tuple[Starts, Entries]:
    """Return the rows of some nodes and of those below them, in CSR form (starts, rows).

    order, begins: all rows in the order of their nodes, and where those of each begin.
    """
    lengths = np.diff(begins)[inside.indices]
    skipped = begins[inside.indices] - (np.cumsum(lengths) - lengths)
    rows = order[np.arange(lengths.sum()) + np.repeat(skipped, lengths)]
    return np.append(0, np.cumsum(inside @ np.diff(begins))).astype(np.int64), rows


def _masses(
    field: LanguageField, gaussians: Gaussians, inside: csr_array, node_of: NodeOfRow
) -> Float32[np.ndarray, " T"]:
    kept = node_of >= 0
    opacities = gaussians.opacities[field.gaussian_ids[kept]]
    own = np.bincount(node_of[kept], opacities, inside.shape[0])
    return np.asarray(inside @ own, np.float32)


def _num_views(weights: csr_array, evidence: Evidence) -> Int32[np.ndarray, " T"]:
    """Return the photos that show more than a sliver of each node."""
    shown = shown_in_photos(weights, evidence)
    nodes = entry_rows(shown)
    most = np.zeros(shown.shape[0])
    np.maximum.at(most, nodes, shown.data)
    return np.bincount(nodes[shown.data > MIN_SHOWN_SHARE * most[nodes]], minlength=shown.shape[0]).astype(np.int32)


def shown_in_photos(weights: csr_array, evidence: Evidence) -> csr_array:
    """Return (T, V) the weight of each node in each photo. weights: (T, M) in each mask."""
    views, count = evidence.masks.views, len(evidence.masks.view_names)
    of_view = csr_array((np.ones(len(views)), (np.arange(len(views)), views)), shape=(len(views), count))
    return csr_array(weights @ of_view)


def _masks(weights: csr_array) -> tuple[Starts, Int32[np.ndarray, " E"], Float32[np.ndarray, " E"]]:
    """Return each node's masks of the largest shares of its weight, largest first, in CSR form."""
    kept = heaviest(weights, MAX_MASKS_PER_NODE)
    totals: Float64[np.ndarray, " T"] = weights.sum(axis=1)
    shares = kept.data / np.repeat(totals, np.diff(kept.indptr))
    return kept.indptr.astype(np.int64), kept.indices.astype(np.int32), shares.astype(np.float32)


def _exclusive(weights: csr_array, evidence: Evidence) -> csr_array:
    """Return R_tj q_tj: the weight of node t in mask j, times the share of the mask's weight that lies in the node.

    A mask of the whole table says little of the mug on it.
    """
    totals = np.zeros(len(evidence.masks))
    for rows in row_chunks(evidence.weights):  # added up in turn, as if all at once
        entries = slice(evidence.weights.indptr[rows.start], evidence.weights.indptr[rows.stop])
        np.add.at(totals, evidence.weights.indices[entries], evidence.weights.data[entries].astype(np.float64))
    exclusive = weights.data * (weights.data / np.maximum(totals[weights.indices], weights.data))
    return csr_array((exclusive, weights.indices, weights.indptr), shape=weights.shape)


def descriptors(
    weights: csr_array, embeddings: Float32[np.ndarray, "M D"], *, threads: int = 0
) -> tuple[Starts, Float32[np.ndarray, "P D"]]:
    """Return up to four unit vectors for each row of `weights` (T, M), as row starts and vectors, the heaviest first.

    The first centre is the weighted mean; a further one starts from the mask that is served worst, weight times
    (1 - cosine), as long as one is unlike all centres. The same bits at any number of threads.
    """
    clusters = _Clusters(heaviest(weights, MAX_MASKS_CLUSTERED), embeddings, threads)
    labels = np.zeros(clusters.weights.nnz, np.int64)
    part = np.arange(len(labels))  # entries of rows that may need more
    for count in range(1, MAX_DESCRIPTORS_PER_NODE):
        far = part[clusters.worst_served(part, clusters.cosines(labels, part, count).max(axis=1, initial=-1))]
        needing = np.zeros(weights.shape[0], bool)
        needing[clusters.rows[far]] = True
        part = part[needing[clusters.rows[part]]]
        labels[far] = count
        clusters.settle(labels, part, count + 1)
    return clusters.centers(labels)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Up to MAX_DESCRIPTORS_PER_NODE clusters in each row. weights: (T, M), with the entries that are put into them.

    labels: the cluster of each entry, counted in its row. part: numbers of some of the entries.
    """

    weights: csr_array
    embeddings: Float32[np.ndarray, "M D"]
    threads: int

    @cached_property
    def rows(self) -> Entries:
        return entry_rows(self.weights)

    def settle(self, labels: Entries, part: Int64[np.ndarray, " p"], count: int) -> None:
        """Move the entries of `part` to the cluster of the nearest centre, the first of equal ones, in some rounds."""
        for _ in range(LLOYD_ROUNDS):
            nearest = self.cosines(labels, part, count).argmax(axis=1)
            if (nearest == labels[part]).all():
                break
            labels[part] = nearest

    def worst_served(
        self, part: Int64[np.ndarray, " p"], cosines: Float32[np.ndarray, " p"]
    ) -> Int64[np.ndarray, " t"]:
        """Return the place of each row's worst served entry of `part`, among those that are unlike all centres."""
        served = np.where(cosines < ALIKE_COSINE, self.weights.data[part] * (1 - cosines.astype(np.float64)), 0)
        rows = self.rows[part]
        most = np.zeros(self.weights.shape[0])
        np.maximum.at(most, rows, served)
        (worst,) = np.nonzero((served > 0) & (served == most[rows]))
        return np.asarray(worst[np.diff(rows[worst], prepend=-1) > 0])

    def means(self, labels: Entries) -> Float32[np.ndarray, "T k D"]:
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

    def cosines(self, labels: Entries, part: Int64[np.ndarray, " p"], count: int) -> Float32[np.ndarray, "p k"]:
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

    def centers(self, labels: Entries) -> tuple[Starts, Float32[np.ndarray, "P D"]]:
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
    """Return up to `most` entries of each row, the heaviest first, of equal ones the first column first."""
    rows = entry_rows(matrix)
    (heavy,) = np.nonzero(matrix.data >= _bars(matrix, most)[rows])  # and more, where some are equal
    order = heavy[np.lexsort((matrix.indices[heavy], -matrix.data[heavy], rows[heavy]))]
    begins = np.searchsorted(rows[order], np.arange(matrix.shape[0]))
    kept = order[np.arange(len(order)) - begins[rows[order]] < most]
    starts = np.append(0, np.cumsum(np.minimum(np.diff(matrix.indptr), most)))
    return csr_array((matrix.data[kept], matrix.indices[kept], starts), shape=matrix.shape)


def _bars(matrix: csr_array, most: int) -> Float64[np.ndarray, " r"]:
    """Return the `most`-th largest weight of each row, -inf where it has no more than that."""
    bars = np.full(matrix.shape[0], -np.inf)
    for row in np.flatnonzero(np.diff(matrix.indptr) > most):
        data = matrix.data[matrix.indptr[row] : matrix.indptr[row + 1]]
        bars[row] = np.partition(data, len(data) - most)[len(data) - most]
    return bars
