"""Regions of Gaussians that the masks of the photos hold together, merged step by step (native)."""

from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from .. import _native
from ..base.arrays import Ids, Int64, Integer, Numbers, OtherEmbeddings, Sparse
from .splats import native


@dataclass(frozen=True)
class MergeRule:
    """Rule for merging two neighbouring regions; see docs/grouping.md.

    soft: the weight in a view at which the view counts half. far: of a region's weight, for how well masks fit it.
    local: the share of the agreement along the border, the rest is that of the regions as wholes. prior, least: the
    agreement of regions that no view sees both of, and how much of one view it counts for. unlike: what unrelated
    embeddings cost; unit: how far apart those are. tolerance: how far below its best a region merges as well.
    rounds: at most, at each threshold. smallest: Gaussians of a region that is judged. linked: a chain
    of regions that are each other's best is merged as far as the heaviest on both sides agree by this share of the
    threshold, so that what is faint and like two regions does not link them.
    """

    soft: float
    far: float
    local: float = 0.15
    prior: float = 0.5
    least: float = 0.3
    unlike: float = 0.15
    unit: float = 1.0
    tolerance: float = 0.02
    rounds: int = 2
    smallest: int = 30
    linked: float = 0.25


class Forest(NamedTuple):
    """Tree of merges: nodes 0 to N - 1 are the rows, later ones merges.

    parents: a parent has a higher number than its children, -1 is none. agreements: the threshold of the merge.
    sizes: rows; masses: their weight. fits: the mean, over the views that see a region, of the IoU with the mask most
    like it there. spreads: the largest distance of embeddings that was merged in it, 1 for unrelated ones. fits and
    spreads are 0 for regions below `smallest`.
    """

    parents: Ids
    agreements: Numbers
    sizes: Ids
    masses: Numbers
    fits: Numbers
    spreads: Numbers


def agglomerate(
    weights: Sparse,
    views: Ids,
    embeddings: OtherEmbeddings,
    edges: Integer[np.ndarray, "e 2"],
    thresholds: tuple[float, ...],
    rule: MergeRule,
    *,
    order: Int64[np.ndarray, " r"] | None = None,
    threads: int = 0,
) -> Forest:
    """Merge neighbours that are each other's best, as long as they agree by more than each threshold in turn.

    weights: W, (N, M), columns ascending in each row. views: of each mask, never falling. embeddings: unit, or of
    fewer dimensions but with nearly the same cosines. edges: neighbours (a, b), a < b. order: the row of W of each row
    of the forest and of the edges; None: the same. Work and memory are linear in
    weights and edges, times the few rounds; the same bits for any number of threads.

    Raises: InputError: arrays that are not so.
    Twin: tests/twins/regions.py::agglomerate.
    """
    given = (
        np.arange(weights.shape[0]) if order is None else order,
        np.asarray(weights.indptr, np.int64), np.asarray(weights.indices, np.int32),
        np.asarray(weights.data, np.float32), np.asarray(views, np.int32), np.asarray(embeddings, np.float32),
        np.asarray(edges, np.int32).reshape(-1, 2), np.asarray(thresholds, np.float64),
        np.asarray(astuple(rule), np.float64),
    )  # fmt: skip
    return Forest(*native("regions", _native.agglomerate, *given, threads))
