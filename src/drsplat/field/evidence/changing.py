"""W with columns taken out and others put in, in one pass over its entries: what is new is sorted, the rest copied."""

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Doubles, Flags, Ids, OtherFlags
from ...errors import MismatchError
from ...kernels.algebra import changed_columns as merged
from .aggregation.entries import canonical
from .evidence import Evidence, MaskIds

REMOVED_COLUMN = -1


def without_views(evidence: Evidence, gone: Flags) -> Evidence:
    """Return the evidence without the columns of the views `gone`."""
    masks = evidence.masks
    names = tuple(name for name, goes in zip(masks.view_names, gone.tolist(), strict=True) if not goes)
    number, kept = (np.cumsum(~gone) - 1).astype(np.int32), ~gone[masks.views]
    columns = np.where(kept, np.cumsum(kept) - 1, REMOVED_COLUMN).astype(np.int32)
    none = csr_array((len(evidence), int(kept.sum())), dtype=np.float32)
    times = None if masks.times is None else masks.times[~gone]
    rendered = _rendered(tuple(source for source, goes in zip(masks.sources, gone.tolist(), strict=True) if not goes))
    ids = MaskIds(names, number[masks.views[kept]], masks.ids[kept], times, rendered)
    return Evidence(changed_columns(evidence.weights, columns, none), ids, evidence.embeddings[kept])


def with_views(evidence: Evidence, other: Evidence) -> Evidence:
    """Merge the evidence of different views of the same Gaussians: columns by view name, then mask id."""
    evidence, other = canonical(evidence), canonical(other)
    names = sorted(evidence.masks.view_names + other.masks.view_names)
    rank = {name: number for number, name in enumerate(names)}
    both = (evidence.masks, other.masks)
    views, ids = np.concatenate([_ranked(masks, rank) for masks in both]), np.concatenate([m.ids for m in both])
    order = np.lexsort((ids, views))
    places = np.empty(len(order), np.int32)
    places[order] = np.arange(len(order), dtype=np.int32)
    own, its = np.split(places, [len(evidence.masks)])
    new = other.weights
    added = csr_array((new.data, its[new.indices], new.indptr), shape=(len(other), len(order)))
    # concatenate the rows of both and put them in an order, copying runs of consecutive rows at once
    ends = np.append(np.flatnonzero((np.diff(order) != 1) | (order[1:] == len(evidence.embeddings))) + 1, len(order))
    parts, begin = [evidence.embeddings[:0]], 0
    for end in ends.tolist() if len(order) else []:
        first = int(order[begin])
        source, first = (
            (evidence.embeddings, first)
            if first < len(evidence.embeddings)
            else (other.embeddings, first - len(evidence.embeddings))
        )
        parts.append(source[first : first + end - begin])
        begin = end
    embeddings = np.concatenate(parts)
    of_view = {name: source for masks in both for name, source in zip(masks.view_names, masks.sources, strict=True)}
    rendered = _rendered(tuple(of_view[name] for name in names))
    masks = MaskIds(tuple(names), views[order], ids[order], _times(both, rank), rendered)
    return Evidence(changed_columns(evidence.weights, own, added), masks, embeddings)


def _rendered(sources: tuple[str, ...]) -> tuple[str, ...]:
    """Return `MaskIds.rendered_from` of the sources of all views."""
    return sources if any(sources) else ()


def _times(both: tuple[MaskIds, MaskIds], rank: dict[str, int]) -> Doubles | None:
    """Return the views' times by rank; None for a still scene. Raises: MismatchError: only one of both scenes moves."""
    one, other = (masks.times for masks in both)
    if one is None or other is None:
        if one is not other:
            raise MismatchError(
                "one is of a scene that moves, whose views have times, the other of one that stands still: register "
                "both with the same scene"
            )
        return None
    times = np.empty(len(rank))
    times[[rank[name] for masks in both for name in masks.view_names]] = np.concatenate([one, other])
    return times


def rows_with(weights: csr_array, columns: OtherFlags) -> Flags:
    """Return which rows have an entry in any of some columns."""
    rows = np.zeros(weights.shape[0], np.bool_)
    entries = np.flatnonzero(columns[weights.indices])
    rows[np.searchsorted(weights.indptr, entries, side="right") - 1] = True
    return rows


def changed_columns(weights: csr_array, columns: Ids, added: csr_array) -> csr_array:
    """Renumber W's columns and add entries; the entries of a row must ascend, and ascend in the result.

    columns: the new number of each old column, ascending, or REMOVED_COLUMN. added: entries of as many rows, with the
    new numbers.
    """
    pair = ((part.indptr, part.indices, part.data) for part in (weights, added))
    starts, indices, data = merged(next(pair), columns, next(pair))
    # SciPy gives both index arrays the wider type: int64 starts would make 12 bytes of the 8.
    indptr = starts.astype(np.int32 if starts[-1] < 1 << 31 else np.int64)
    return csr_array((data, indices, indptr), shape=added.shape)


def _ranked(masks: MaskIds, rank: dict[str, int]) -> Ids:
    return np.array([rank[name] for name in masks.view_names], np.int32).take(masks.views)
