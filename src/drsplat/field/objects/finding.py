"""Objects from the masks of photos: what belongs together is in one mask wherever it is seen.

Two Gaussians of one thing lie in the same mask in the photos that see both. Neighbours are merged, best first, while
their masks agree; of the regions that come about, things are those that single masks fit best. See docs/objects.md.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float32, Int32, UInt32
from ...errors import InputError
from ...kernels import Forest, MergeRule, agglomerate
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .. import LanguageField
from ..evidence.aggregation.entries import column_counts, of_columns
from ..evidence.changing import without_views
from ..evidence.evidence import Evidence
from ..forest import THING, Objects
from ..learning import drawn
from .borders import borders
from .choosing import NONE, Tree, _owners, choose
from .describing import describe
from .joining import join, with_joined
from .neighbours import along_a_curve, neighbours

THRESHOLDS = tuple(k / 100 for k in range(95, 10, -5))
SOFT = 0.55  # of what a photo shows of a Gaussian in the mean
SIGHT = 1.2e-4  # of the weight of a photo
SMALLEST = 30  # Gaussians
DIRECTIONS = 32  # of embeddings that are looked at
MOST_WEIGHTS = 32_000_000  # that are held at once, in some 66 bytes each


def find_objects(
    field: LanguageField, gaussians: Gaussians, *, views: Sequence[View] | None = None, threads: int = 0
) -> Objects:
    """Find the things of a scene, with their parts and groups, in the evidence that its field keeps.

    views: whose cameras tell which pieces are one thing (`joining`); None: those that the field keeps. No encoder is
    needed. Time and memory are linear in the weights, of which up to MOST_WEIGHTS are looked at: of more
    those of some views, which a hash of their names draws. The same bits at any number of threads.

    Raises: InputError: the field keeps no evidence. MismatchError: it is of another scene.
    Source: agglomeration by agreement over views as in Trace3D and SAI3D; see docs/objects.md.
    """
    field.check_scene(gaussians)
    if field.evidence is None:
        raise InputError("objects are found in the evidence, and this field was saved without: register again")
    cameras = cameras_of(field) if views is None else views
    tree = find_tree(field.evidence, gaussians, field.gaussian_ids, cameras, threads=threads)
    return describe(field, gaussians, tree, threads=threads)


def find_tree(
    evidence: Evidence, gaussians: Gaussians, ids: UInt32[np.ndarray, " r"], views: Sequence[View], *, threads: int = 0
) -> Tree:
    """Return the parts, things and groups of a scene. Where masks have equal embeddings, W alone decides.

    Args:
        evidence: W, a row for each of `ids`, none of them empty.
        gaussians: the scene.
        ids: the Gaussians of the rows.
        views: whose cameras tell which pieces are one thing; none: pieces stay as they are.
        threads: 0 for all cores; the same bits at any number.
    """
    forest = grow(of_few_views(evidence), gaussians.means[ids], threads=threads)
    tree = choose(forest, len(ids), SMALLEST)
    return of_pieces(tree, gaussians, ids, views, threads=threads) if views else tree


def of_pieces(
    tree: Tree, gaussians: Gaussians, ids: UInt32[np.ndarray, " r"], views: Sequence[View], *, threads: int = 0
) -> Tree:
    """Return the tree with pieces joined to the things that they are of. ids: the Gaussians of its rows."""
    (things,) = np.nonzero(tree.levels == THING)
    owners = _owners(tree.parents, tree.levels == THING)
    numbers = np.append(np.where(owners >= 0, np.searchsorted(things, owners), NONE), NONE)
    pieces = np.full(len(gaussians), NONE, np.int32)
    pieces[ids] = numbers[tree.node_of]
    return with_joined(tree, join(borders(gaussians, views, pieces, threads=threads), tree.sure[things]))


def cameras_of(field: LanguageField) -> list[View]:
    """Return the views of a field's photos, without the photos; none where it keeps none, or where the scene moves."""
    if field.growth is None or field.evidence is None or field.times is not None:
        return []
    return field.growth.provenance.views(field.evidence.masks.view_names)


def of_few_views(evidence: Evidence, most: int = MOST_WEIGHTS) -> Evidence:
    """Return the evidence of as many views as have `most` weights together, or itself if it has no more."""
    if evidence.weights.nnz <= most:
        return evidence
    masks, entries = evidence.masks, column_counts(evidence.weights)
    counts = np.bincount(masks.views, entries, len(masks.view_names))
    order = np.array(sorted(range(len(counts)), key=lambda view: drawn(masks.view_names[view])))
    gone = np.ones(len(counts), np.bool_)
    gone[order[: max(1, np.searchsorted(np.cumsum(counts[order]), most, side="right"))]] = False
    return without_views(of_columns(evidence, ~gone[masks.views]), gone)


def grow(evidence: Evidence, means: Float32[np.ndarray, "r 3"], *, threads: int = 0) -> Forest:
    """Grow the forest of merges over the rows of the evidence. means: the Gaussians' centres."""
    order = along_a_curve(means)
    weights, views, embeddings = _by_view(evidence)
    embeddings, unit = _fewer_directions(embeddings)
    total = float(weights.data.sum(dtype=np.float64))
    soft, far = SOFT * total / max(_sights(weights, views), 1), SIGHT * total / max(len(np.unique(views)), 1)
    rule = MergeRule(max(soft, 1e-6), max(far, 1e-6), unit=unit, smallest=SMALLEST)
    edges = neighbours(means[order], threads)
    forest = agglomerate(csr_array(weights[order]), views, embeddings, edges, THRESHOLDS, rule, threads=threads)
    places = np.arange(len(forest.parents))
    places[order] = np.arange(len(order))
    return Forest(*(values[places] for values in forest))


def _by_view(evidence: Evidence) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Return its weights, views and embeddings with the masks in the order of their views."""
    weights, views, embeddings = evidence.weights, evidence.masks.views, evidence.embeddings
    if (np.diff(views) < 0).any():
        order = np.argsort(views, kind="stable")
        weights, views, embeddings = csr_array(weights[:, order]), views[order], embeddings[order]
    if not weights.has_canonical_format:
        weights = weights.copy()
        weights.sum_duplicates()
    return weights, views, embeddings


def _sights(weights: csr_array, views: Int32[np.ndarray, " m"]) -> int:
    """Count in how many views a row has weight, of all rows together."""
    seen = views[weights.indices]
    first = np.ones(len(seen), bool)
    first[1:] = seen[1:] != seen[:-1]
    first[weights.indptr[:-1][np.diff(weights.indptr) > 0]] = True
    return int(np.count_nonzero(first))


def _fewer_directions(embeddings: Float32[np.ndarray, "m d"]) -> tuple[Float32[np.ndarray, "m k"], float]:
    """Return the embeddings along the directions in which they spread most, and 1 - the mean cosine of any two."""
    exact = embeddings.astype(np.float64)
    unit = max(1 - float(np.square(exact.mean(0)).sum()), 1e-3) if len(exact) else 1.0
    directions = np.linalg.eigh(exact.T @ exact)[1][:, -DIRECTIONS:]
    # rounded: sums of other orders, as libraries make them on other machines, then give the same bits
    return np.round(exact @ directions, 4).astype(np.float32), unit
