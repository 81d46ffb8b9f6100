"""W with columns taken out and others put in, in one pass over its entries: what is new is sorted, the rest copied."""

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Flags, Ids, OtherFlags
from ...errors import MismatchError
from ...kernels.algebra import changed_columns as merged
from .aggregation.entries import by_name, canonical
from .evidence import Evidence, MaskIds, csr_of

REMOVED_COLUMN = -1


def without_views(evidence: Evidence, gone: Flags) -> Evidence:
    """Return the evidence without the columns of the views `gone`."""
    (columns,) = np.nonzero(~gone[evidence.masks.views])
    number = np.full(len(evidence.masks), REMOVED_COLUMN, np.int32)
    number[columns] = np.arange(len(columns), dtype=np.int32)
    none = csr_array((len(evidence), len(columns)), dtype=np.float32)
    masks = evidence.masks.taken(np.flatnonzero(~gone), columns)
    return Evidence(changed_columns(evidence.weights, number, none), masks, evidence.embeddings[columns])


def with_views(evidence: Evidence, other: Evidence) -> Evidence:
    """Merge the evidence of different views of the same Gaussians: columns by view name, then mask id.

    Raises: MismatchError: only one of both scenes moves.
    """
    evidence, other = canonical(evidence), canonical(other)
    one, two = evidence.masks, other.masks
    times = [masks.times for masks in (one, two) if masks.times is not None]
    if len(times) == 1:
        raise MismatchError(
            "one is of a scene that moves, whose views have times, the other of one that stands still: register both "
            "with the same scene"
        )
    both = MaskIds(
        one.view_names + two.view_names, np.append(one.views, two.views + np.int32(len(one.view_names))),
        np.append(one.ids, two.ids), np.concatenate(times) if times else None, one.sources + two.sources,
    )  # fmt: skip
    masks, order = by_name(both)
    places = np.empty(len(order), np.int32)
    places[order] = np.arange(len(order), dtype=np.int32)
    own, its = np.split(places, [len(one)])
    new = other.weights
    added = csr_array((new.data, its[new.indices], new.indptr), shape=(len(other), len(order)))
    embeddings = np.empty((len(order), evidence.dim), np.float32)
    embeddings[own], embeddings[its] = evidence.embeddings, other.embeddings
    return Evidence(changed_columns(evidence.weights, own, added), masks, embeddings)


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
    return csr_of(*merged(next(pair), columns, next(pair)), added.shape[1])
