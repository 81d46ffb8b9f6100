"""Choice of the masks to embed where objects are known: a few of each object, which represent the others.

W needs masks and no embeddings, and objects need W alone. So masks of many photos that show the same part, thing or
group need not be embedded one by one. See docs/embedding.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float32, Float64, Int64
from ...field.evidence.evidence import Evidence
from ...field.objects.describing import node_weights
from ...field.objects.finding import find_tree
from ...scene.gaussians import Gaussians
from ...scene.views import View

MAX_CROPS_PER_OBJECT = 12
MIN_FIT = 0.5
"""IoU, by weight, above which a mask shows a node; of disjoint nodes at most one has more."""
NEAREST_SHARE = 0.5
"""Weight of the crop whose camera is nearest; all crops of the node share the rest."""


@dataclass(frozen=True, eq=False)
class SharedCrops:
    """Columns of W whose crops are embedded, and their shares in all columns.

    Attributes:
        chosen: columns that are embedded, ascending.
        shares: (M, C) weights of the chosen columns for each column; each row sums to 1.
    """

    chosen: Int64[np.ndarray, " c"]
    shares: csr_array

    def embeddings(self, rows: Float32[np.ndarray, "c d"]) -> Float32[np.ndarray, "m d"]:
        """Return a unit vector for each column from the vectors of the chosen ones."""
        mixed = self.shares @ rows.astype(np.float64)
        return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True), np.float32)


def share_crops(
    evidence: Evidence,
    gaussians: Gaussians,
    views: Sequence[View],
    *,
    most: int = MAX_CROPS_PER_OBJECT,
    threads: int = 0,
) -> SharedCrops:
    """Choose the crops to embed. A mask that shows no object represents itself alone.

    Args:
        evidence: W, a row for each Gaussian. Its embeddings are not looked at if all are equal.
        gaussians: the scene.
        views: the cameras of all photos in the evidence.
        most: crops of a node.
        threads: 0 for all cores; the result does not depend on it.
    """
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    with_weight = evidence.rows(ids)
    tree = find_tree(with_weight, gaussians, ids.astype(np.uint32), views, threads=threads)
    node_of, fit = _best_nodes(node_fits(node_weights(with_weight, tree), with_weight))
    worth, centers = fit * _column_sums(with_weight), _camera_centers(with_weight, views)
    (alone,) = np.nonzero(node_of < 0)
    rows, columns, data = [alone], [alone], [np.ones(len(alone))]
    for masks in _groups(node_of):
        picks, distances = _spread(worth[masks], centers[masks], most)
        shares = np.full(distances.shape, (1 - NEAREST_SHARE) / len(picks))
        shares[np.arange(len(masks)), distances.argmin(1)] += NEAREST_SHARE
        rows.append(np.repeat(masks, len(picks)))
        columns.append(np.tile(masks[picks], len(masks)))
        data.append(shares.ravel())
    chosen, numbers = np.unique(np.concatenate(columns), return_inverse=True)
    places = np.concatenate(rows), numbers
    return SharedCrops(chosen, csr_array((np.concatenate(data), places), shape=(len(node_of), len(chosen))))


def node_fits(inside: csr_array, evidence: Evidence) -> csr_array:
    """Return the IoU of each node with each mask, by weight in the mask's photo, (T, M).

    Args:
        inside: (T, M) weight of each node in each mask.
        evidence: W of the same columns.
    """
    views, count = evidence.masks.views, len(evidence.masks.view_names)
    by_view = csr_array((np.ones(len(views)), (np.arange(len(views)), views)), shape=(len(views), count))
    in_photos = csr_array(inside @ by_view)
    nodes = np.repeat(np.arange(inside.shape[0]), np.diff(inside.indptr))
    either = in_photos[nodes, views[inside.indices]] + _column_sums(evidence)[inside.indices] - inside.data
    return csr_array((inside.data / np.maximum(either, 1e-12), inside.indices, inside.indptr), shape=inside.shape)


def _column_sums(evidence: Evidence) -> Float64[np.ndarray, " m"]:
    weights = evidence.weights
    return np.bincount(weights.indices, weights.data, weights.shape[1])


def _camera_centers(evidence: Evidence, views: Sequence[View]) -> Float64[np.ndarray, "m 3"]:
    """Return the centre of the camera of each column."""
    by_name = {view.name: view.center for view in views}
    centers = np.array([by_name[name] for name in evidence.masks.view_names], np.float64).reshape(-1, 3)
    return np.asarray(centers[evidence.masks.views])


def _best_nodes(fits: csr_array) -> tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Return for each mask the node that it fits best, -1 where none by more than MIN_FIT, and the fit."""
    nodes = np.repeat(np.arange(fits.shape[0]), np.diff(fits.indptr))
    order = np.lexsort((nodes, -fits.data, fits.indices))
    columns, first = np.unique(fits.indices[order], return_index=True)
    node_of, fit = np.full(fits.shape[1], -1), np.zeros(fits.shape[1])
    node_of[columns], fit[columns] = nodes[order[first]], fits.data[order[first]]
    node_of[fit <= MIN_FIT] = -1
    return node_of, fit


def _groups(node_of: Int64[np.ndarray, " m"]) -> list[Int64[np.ndarray, " k"]]:
    """Return the masks of each node that has any, ascending."""
    order = np.argsort(node_of, kind="stable")
    order = order[np.searchsorted(node_of[order], 0) :]
    return np.split(order, np.flatnonzero(np.diff(node_of[order])) + 1) if len(order) else []


def _spread(
    worth: Float64[np.ndarray, " k"], centers: Float64[np.ndarray, "k 3"], most: int
) -> tuple[Int64[np.ndarray, " p"], Float64[np.ndarray, "k p"]]:
    """Pick the mask of most worth, then masks of high worth whose cameras are far from all picked before.

    Returns:
        The picks, and the distance of each mask's camera from theirs.
    """
    picks: list[int] = []
    distances: list[Float64[np.ndarray, " k"]] = []
    gain = worth
    while len(picks) < min(most, len(worth)) and gain.max() > 0:  # 0: the rest are of picked cameras
        picks.append(int(gain.argmax()))
        distances.append(np.linalg.norm(centers - centers[picks[-1]], axis=1))
        gain = np.sqrt(worth) * np.min(distances, axis=0)
    return np.array(picks), np.stack(distances, 1)
