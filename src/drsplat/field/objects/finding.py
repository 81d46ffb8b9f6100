"""Objects from the masks of photos: what belongs together is in one mask wherever it is seen.

Two Gaussians of one thing lie in the same mask in the photos that see both. Neighbours are merged, best first, while
their masks agree; of the regions that come about, things are those that single masks fit best. See docs/grouping.md.

Of a scene that is too large for one forest, each block gets one, and the scene one of all their nodes:

W, places -> blocks               of a few million weights, each with what is around it
a block   -> its nodes            in the memory of that block, by whoever has time
all nodes -> nodes of the scene   what two blocks see of one region is told by the rows that both look at
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Arrays, Flags, Float32, Ids, UnsignedIds, Vectors
from ...base.contents import release
from ...base.working import HERE, Held, Here, Work
from ...errors import InputError
from ...kernels import Forest, MergeRule, agglomerate
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .. import LanguageField
from ..evidence.aggregation.entries import canonical, column_counts, row_chunks, view_runs
from ..evidence.columns import Scenery
from ..evidence.evidence import Evidence
from ..evidence.pieces import HeldRows
from ..forest import THING, Objects, owner_nodes
from ..learning import drawn
from .block_nodes import Block, Nodes, along_a_curve, in_blocks, neighbours
from .borders import borders, some_views
from .choosing import NONE, Tree, choose
from .describing import describe
from .joining import join, with_joined
from .uniting import Masses, united

MERGE_THRESHOLDS = tuple(k / 100 for k in range(95, 10, -5))
SOFT_SIGHT_SHARE = 0.55  # of what a photo shows of a Gaussian on average
FAR_PHOTO_SHARE = 1.2e-4  # of the weight of a photo
MIN_GAUSSIANS = 30  # of a node
MAX_DIRECTIONS = 32  # of embeddings
MAX_WEIGHTS = 32_000_000  # held at once, in some 35 bytes each: scenes of more are cut into blocks
WEIGHTS_PER_ROW = 64  # on average, of scenes in blocks: of more, those of some views are looked at
MASKS_AT_ONCE = 1 << 16
BLOCK_WEIGHTS = 8_000_000  # of a block, without what is around it


@dataclass(frozen=True, eq=False)
class Totals:
    """Adds up a piece of W over the columns that are looked at: a `Part`.

    masks: `kept` and `views` of the columns. Of each row `sums` and `counts` are found, of each column `masses`, and
    `sights`: views that see a row, of all rows together.
    """

    weights: HeldRows
    masks: Held

    def __call__(self, number: int, threads: int) -> Arrays:
        weights, (kept, views) = self.weights.piece(number), (self.masks.arrays[name] for name in ("kept", "views"))
        count, num_views = weights.shape[0], np.int64(views.max(initial=0) + 1)
        sums, counts, masses, sights = np.zeros(count), np.zeros(count, np.int64), np.zeros(len(views)), 0
        for part in row_chunks(weights):
            starts = weights.indptr[part.start : part.stop + 1].astype(np.int64)
            columns, data = weights.indices[starts[0] : starts[-1]], weights.data[starts[0] : starts[-1]]
            held = kept[columns] & (data > 0)
            at = np.repeat(np.arange(part.stop - part.start), np.diff(starts))[held]
            columns, data = columns[held], data[held]
            sums[part] = np.bincount(at, data, part.stop - part.start)
            counts[part] = np.bincount(at, minlength=part.stop - part.start)
            masses += np.bincount(columns, data, len(masses))
            seen = at * num_views + views[columns]
            sights += int(np.count_nonzero(np.diff(np.sort(seen), prepend=-1)))
        return {"sums": sums, "counts": counts, "masses": masses, "sights": np.array([sights])}


class Division(NamedTuple):
    """A scene in blocks, in an order that only places and weights decide. nodes: what finds those of a block."""

    nodes: Nodes
    blocks: list[Block]
    masses: Masses


def find_objects(
    field: LanguageField, gaussians: Gaussians, *, views: Sequence[View] | None = None,
    threads: int = 0, scenery: Scenery | None = None, work: Work | None = None,
) -> Objects:  # fmt: skip
    """Find the things of a scene, with their parts and groups, in the evidence that its field keeps.

    views: whose cameras tell which pieces are one thing (`joining`); None: those that the field keeps. No encoder is
    needed. Time is linear in the weights, and memory up to MAX_WEIGHTS; a scene of more is looked at in blocks
    (`divided`). The same bits at any number of threads. scenery, work: see `find_tree`.

    Raises: InputError: the field keeps no evidence. MismatchError: it is of another scene.
    Source: agglomeration by agreement over views as in Trace3D and SAI3D; see docs/grouping.md.
    """
    field.check_scene(gaussians)
    if field.evidence is None:
        raise InputError("objects are found in the evidence, and this field was saved without: register again")
    cameras, work = cameras_of(field) if views is None else views, work or Here(threads)
    tree = find_tree(field.evidence, gaussians, field.gaussian_ids, cameras, scenery=scenery, work=work)
    return describe(field, gaussians, tree, work=work)


def find_tree(
    evidence: Evidence, gaussians: Gaussians, ids: UnsignedIds, views: Sequence[View], *,
    threads: int = 0, scenery: Scenery | None = None, work: Work | None = None,
) -> Tree:  # fmt: skip
    """Return the parts, things and groups of a scene. Where masks have equal embeddings, W alone decides.

    Args:
        evidence: W, a row for each of `ids`, none of them empty.
        gaussians: the scene.
        ids: the Gaussians of the rows.
        views: whose cameras tell which pieces are one thing; none: pieces stay as they are.
        threads: 0 for all cores; the same bits at any number.
        scenery: what the cameras see; None: the Gaussians.
        work: who does it; None: this process.
    """
    work = work or Here(threads)
    found = tree_of(evidence, np.asarray(gaussians.means[ids]), work)
    return of_pieces(found.tree, gaussians, ids, seen_by(found, views), scenery=scenery, work=work)


class Found(NamedTuple):
    """Parts, things and groups that masks tell of. seeing: of each block the names of the views that see it."""

    tree: Tree
    seeing: list[set[str]]


def seen_by(found: Found, views: Sequence[View]) -> list[View]:
    """Return the views that are looked at for pieces: some of those that see each block."""
    chosen = [some_views(view for view in views if view.name in names) for names in found.seeing]
    return list({view.name: view for some in chosen for view in some}.values()) if chosen else some_views(views)


def tree_of(evidence: Evidence, points: Vectors, work: Work = HERE) -> Found:
    """Find the parts, things and groups that masks tell of; what they are pieces of is not yet known.

    points: centres of the rows' Gaussians. work: who finds the nodes of blocks, of which there are some where the
    evidence has more than MAX_WEIGHTS.
    """
    if evidence.weights.nnz <= MAX_WEIGHTS:
        return Found(choose(grow(evidence, points, threads=work.threads), np.arange(len(points)), MIN_GAUSSIANS), [])
    division, names = divided(evidence, points, work), np.array(evidence.masks.view_names, object)
    parts = work(division.nodes, division.blocks, "finding objects")
    found = united(parts, division.blocks, division.masses, work)
    seeing = [set(names[part.arrays["views"]]) for part in parts]
    return Found(choose(found.forest, found.node_of, MIN_GAUSSIANS), seeing)


def divided(evidence: Evidence, points: Vectors, work: Work = HERE) -> Division:
    """Cut a scene in blocks. Of more weights than WEIGHTS_PER_ROW, those of some views are looked at."""
    masks = evidence.masks
    kept = ~views_beyond(evidence, max(MAX_WEIGHTS, WEIGHTS_PER_ROW * len(evidence)))[masks.views]
    weights = HeldRows.of(evidence.weights, work)
    adding = Totals(weights, work.hold({"kept": kept, "views": masks.views}))
    added = [held.arrays for held in work(adding, range(len(weights.pieces)), "adding up weights")]
    sums, counts, sights = (np.concatenate([one[name] for one in added]) for name in ("sums", "counts", "sights"))
    masses = np.sum([one["masses"] for one in added], axis=0)
    embeddings, unit = _fewer_directions(evidence.embeddings)
    total = float(f"{masses.sum():.9g}")  # however rows are ordered
    rule = _rule(total, int(sights.sum()), len(np.unique(masks.views[kept])), unit)
    scene = {"points": points, "sums": sums, "kept": kept, "masses": masses, "views": masks.views}
    nodes = Nodes(weights, work.hold({**scene, "embeddings": embeddings}), MERGE_THRESHOLDS, rule)
    return Division(nodes, in_blocks(points, counts, BLOCK_WEIGHTS), Masses(sums, masses, masks.views, rule.far))


def of_pieces(
    tree: Tree, gaussians: Gaussians, ids: UnsignedIds, views: Sequence[View], *,
    scenery: Scenery | None = None, work: Work = HERE,
) -> Tree:  # fmt: skip
    """Return the tree with pieces joined to the things that photos show them as; arguments as of `find_tree`."""
    if not views:
        return tree
    is_thing = tree.levels == THING
    numbers = np.append(np.cumsum(is_thing) - 1, NONE)[np.append(owner_nodes(tree.parents, is_thing), NONE)]
    pieces = np.full(len(gaussians), NONE, np.int32)  # the thing of each Gaussian, in the order of nodes
    pieces[ids] = numbers[tree.node_of]
    found = borders(gaussians, views, pieces, scenery=scenery, work=work)
    return with_joined(tree, join(found, tree.sure[is_thing], work))


def cameras_of(field: LanguageField) -> list[View]:
    """Return the views of a field's photos, without the photos; none where it keeps none, or where the scene moves."""
    if field.growth is None or field.evidence is None or field.times is not None:
        return []
    return field.growth.provenance.views(field.evidence.masks.view_names)


def views_beyond(evidence: Evidence, most: int) -> Flags:
    """Mark the views that are left out where at most so many weights are looked at; a hash of names draws the others.

    One view is always left.
    """
    masks = evidence.masks
    gone = np.zeros(len(masks.view_names), np.bool_)
    if evidence.weights.nnz > most:
        counts = np.bincount(masks.views, column_counts(evidence.weights), len(gone))
        order = np.array(sorted(range(len(counts)), key=lambda view: drawn(masks.view_names[view])))
        gone[order[max(1, np.searchsorted(np.cumsum(counts[order]), most, side="right")) :]] = True
    return gone


def grow(evidence: Evidence, means: Vectors, *, threads: int = 0) -> Forest:
    """Grow the forest of merges over the rows of the evidence. means: the Gaussians' centres."""
    order, evidence = along_a_curve(means), canonical(evidence)
    weights, views = evidence.weights, evidence.masks.views
    embeddings, unit = _fewer_directions(evidence.embeddings)
    total, edges = float(weights.data.sum(dtype=np.float64)), neighbours(means[order], threads)
    rule = _rule(total, _count_sights(weights, views), len(np.unique(views)), unit)
    forest = agglomerate(weights, views, embeddings, edges, MERGE_THRESHOLDS, rule, order=order, threads=threads)
    places = np.arange(len(forest.parents))
    places[order] = np.arange(len(order))
    return Forest(*(values[places] for values in forest))


def _count_sights(weights: csr_array, views: Ids) -> int:
    """Count the views that see a row, of all rows together; columns are in the order of their views."""
    count = 0
    for rows in row_chunks(weights):
        begins = weights.indptr[rows.start : rows.stop + 1]
        count += len(view_runs(views[weights.indices[begins[0] : begins[-1]]], begins - begins[0]))
    return count


def _rule(total: float, sights: int, views: int, unit: float) -> MergeRule:
    """Return the rule of a scene. total: weight of all rows; sights: views that see a row, of all rows together."""
    soft, far = SOFT_SIGHT_SHARE * total / max(sights, 1), FAR_PHOTO_SHARE * total / max(views, 1)
    return MergeRule(max(soft, 1e-6), max(far, 1e-6), unit=unit, smallest=MIN_GAUSSIANS)


def _fewer_directions(embeddings: Float32[np.ndarray, "m d"]) -> tuple[Float32[np.ndarray, "m k"], float]:
    """Return the embeddings along the directions in which they spread most, and 1 - the mean cosine of any two."""
    count, dim = embeddings.shape
    mean, spread = np.zeros(dim), np.zeros((dim, dim))
    for begin in range(0, count, MASKS_AT_ONCE):
        exact = embeddings[begin : begin + MASKS_AT_ONCE].astype(np.float64)
        mean += exact.mean(0) * (len(exact) / count)
        spread += exact.T @ exact
        release(embeddings)
    unit = max(1 - float(np.square(mean).sum()), 1e-3) if count else 1.0
    directions = np.linalg.eigh(spread)[1][:, -MAX_DIRECTIONS:]
    # rounded: sums of other orders, as libraries make them on other machines, then give the same bits
    fewer = np.empty((count, directions.shape[1]), np.float32)
    for begin in range(0, count, MASKS_AT_ONCE):
        part = slice(begin, begin + MASKS_AT_ONCE)
        fewer[part] = np.round(embeddings[part].astype(np.float64) @ directions, 4)
    return fewer, unit
