"""Description of a forest's nodes as `Objects`: their boxes, masses, photos, masks and descriptors.

Linear in the weights of the evidence: rows of W are summed into nodes and these into those above, and no step is
nodes times Gaussians.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float32, Float64, Int32, Int64
from ...errors import InputError
from ...kernels.boxes import Boxes, boxes_of
from ...scene.boxes import HAZE_OPACITY
from ...scene.gaussians import Gaussians
from .. import LanguageField
from ..evidence.aggregation.entries import row_chunks
from ..evidence.evidence import Evidence
from ..forest import MAX_MASKS_PER_NODE, Objects, check_forest
from .choosing import Tree, pairs_above
from .descriptors import descriptors
from .heaviest import heaviest

ROWS_AT_ONCE = 1 << 20
NO_BOXES = Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)))
MIN_SHOWN_SHARE = 0.01  # of what the best photo of a node shows of it


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


def objects_during(whole: LanguageField, some: LanguageField, *, threads: int = 0) -> Objects:
    """Return the objects of a field for one made of some of its photos (`field_during`).

    Nodes, numbers, boxes and masks stay; rows are those of the smaller field, descriptors are of what its photos show.

    Raises: InputError: the first has no objects, the second no evidence.
    """
    if whole.objects is None or some.evidence is None:
        raise InputError("expected a field with objects, and one with evidence")
    objects, rows = whole.objects, whole.rows_of(some.gaussian_ids)
    node_of = np.where(rows < 0, np.int32(-1), objects.node_of[rows])
    weights = _weights(some.evidence, _inside(objects.parents), node_of)
    starts, vectors = descriptors(_exclusive(weights, some.evidence), some.evidence.embeddings, threads=threads)
    return replace(objects, node_of=node_of, descriptor_starts=starts, descriptors=vectors)


def _members(node_of: Int32[np.ndarray, " R"], parents: Int32[np.ndarray, " T"]) -> csr_array:
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


def _weights(evidence: Evidence, inside: csr_array, node_of: Int32[np.ndarray, " R"]) -> csr_array:
    """Return (T, M): the summed weight of all rows of a node in each mask."""
    (rows,) = np.nonzero(node_of >= 0)
    place = node_of[rows].astype(np.int32), rows.astype(np.int32)  # of the kind of W's, which SciPy else copies
    own = csr_array((np.ones(len(rows), np.float32), place), shape=(inside.shape[0], len(node_of)))
    summed = inside @ (own @ evidence.weights).astype(np.float64)
    summed.eliminate_zeros()
    summed.sort_indices()
    return csr_array(summed)


def _boxes(
    field: LanguageField, gaussians: Gaussians, inside: csr_array, node_of: Int32[np.ndarray, " R"], threads: int
) -> Boxes:
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
    field: LanguageField, gaussians: Gaussians, starts: Int64[np.ndarray, " T1"], rows: Int64[np.ndarray, " e"],
    threads: int,
) -> Boxes:  # fmt: skip
    nodes = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    ids = field.gaussian_ids[rows].astype(np.int64)
    seen = gaussians.opacities[ids] >= HAZE_OPACITY
    seen |= (np.bincount(nodes[seen], minlength=len(starts) - 1) == 0)[nodes]
    counts = np.bincount(nodes[seen], minlength=len(starts) - 1)
    return boxes_of(gaussians, np.append(0, np.cumsum(counts)), ids[seen], field.up, threads=threads)


def _rows(
    inside: csr_array, order: Int64[np.ndarray, " R"], begins: Int64[np.ndarray, " T1"]
) -> tuple[Int64[np.ndarray, " T1"], Int64[np.ndarray, " e"]]:
    """Return the rows of some nodes and of those below them, in CSR form (starts, rows).

    order, begins: all rows in the order of their nodes, and where those of each begin.
    """
    lengths = np.diff(begins)[inside.indices]
    skipped = begins[inside.indices] - (np.cumsum(lengths) - lengths)
    rows = order[np.arange(lengths.sum()) + np.repeat(skipped, lengths)]
    return np.append(0, np.cumsum(inside @ np.diff(begins))).astype(np.int64), rows


def _masses(
    field: LanguageField, gaussians: Gaussians, inside: csr_array, node_of: Int32[np.ndarray, " R"]
) -> Float32[np.ndarray, " T"]:
    kept = node_of >= 0
    opacities = gaussians.opacities[field.gaussian_ids[kept]]
    own = np.bincount(node_of[kept], opacities, inside.shape[0])
    return np.asarray(inside @ own, np.float32)


def _num_views(weights: csr_array, evidence: Evidence) -> Int32[np.ndarray, " T"]:
    """Return the photos that show more than a sliver of each node."""
    views, count = evidence.masks.views, len(evidence.masks.view_names)
    of_view = csr_array((np.ones(len(views)), (np.arange(len(views)), views)), shape=(len(views), count))
    shown = csr_array(weights @ of_view)
    nodes = np.repeat(np.arange(shown.shape[0]), np.diff(shown.indptr))
    most = np.zeros(shown.shape[0])
    np.maximum.at(most, nodes, shown.data)
    return np.bincount(nodes[shown.data > MIN_SHOWN_SHARE * most[nodes]], minlength=shown.shape[0]).astype(np.int32)


def _masks(weights: csr_array) -> tuple[Int64[np.ndarray, " T1"], Int32[np.ndarray, " E"], Float32[np.ndarray, " E"]]:
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
