"""Gaussians that change what they belong to over time: at each time clear, over all of them not."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Doubles, Indices, OtherDoubles, OtherIndices, RowIds
from ...errors import InputError
from .. import LanguageField
from ..evidence.aggregation.entries import entry_rows

CLEAR_SHARE = 0.8  # of a Gaussian's weight in masks of one object


class Drifting(NamedTuple):
    """Gaussians whose masks name different objects at different times.

    gaussian_ids: rows of the scene, ascending. shares: for each, the largest share that one object has of it over
    all times. first, last: the objects that it belongs to at the first and the last time that it is seen, -1 for what
    is of none.
    """

    gaussian_ids: Indices
    shares: Doubles
    first: Indices
    last: Indices


def drifting(field: LanguageField) -> Drifting:
    """Find the Gaussians whose masks disagree between times.

    A mask is one of the object that has most of its weight, p_i(t) the shares of objects in the weight of Gaussian i in
    the photos of time t, and p_i those in all photos. It drifts where it is clear at each time what it belongs to, the
    mean over t, by weight, of max p_i(t) is 0.8 or more, and it is not over all of them, max p_i < 0.8. A Gaussian at a
    border, whose masks disagree at one time already, is none. Linear in the weights.

    Raises: InputError: a field without evidence, without objects, or of a scene that stands still.
    """
    if field.evidence is None or field.objects is None or field.times is None:
        raise InputError("expected a field of a scene that moves, with its evidence and objects: `drsplat objects`")
    weights, masks = field.evidence.weights, field.evidence.masks
    owner = _owners(weights, field.objects.thing_of())
    stamps, when = np.unique(field.times, return_inverse=True)
    at = entry_rows(weights) * len(stamps) + when[masks.views[weights.indices]]  # row times number of times plus time
    at, thing, weight = _sums(at, owner[weights.indices] + 1, weights.data)
    rows, count = at // len(stamps), len(field)
    totals = np.maximum(np.bincount(rows, weight, minlength=count), np.finfo(np.float64).tiny)
    known, of = np.unique(at, return_inverse=True)
    heaviest = np.zeros(len(known))
    np.maximum.at(heaviest, of, weight)
    clear = np.bincount(known // len(stamps), heaviest, minlength=count) / totals
    of_rows, _, summed = _sums(rows, thing, weight)
    overall = np.zeros(count)
    np.maximum.at(overall, of_rows, summed)
    shares = overall / totals
    (found,) = np.nonzero((clear >= CLEAR_SHARE) & (shares < CLEAR_SHARE))
    strongest = thing[np.lexsort((weight, at))][np.cumsum(np.bincount(of)) - 1]  # of each time
    begin = np.searchsorted(known, found * len(stamps))
    end = np.searchsorted(known, (found + 1) * len(stamps)) - 1
    return Drifting(field.gaussian_ids[found].astype(np.int64), shares[found], strongest[begin] - 1, strongest[end] - 1)


def _owners(weights: csr_array, thing_of: RowIds) -> Indices:
    """Return the object that has most of each mask's weight, -1 for none."""
    rows = np.repeat(thing_of.astype(np.int64) + 1, np.diff(weights.indptr))
    width = int(rows.max(initial=0)) + 1
    pairs, place = np.unique(weights.indices.astype(np.int64) * width + rows, return_inverse=True)
    sums = np.bincount(place, weights.data)
    order = np.lexsort((-(pairs % width), sums, pairs // width))  # of equal ones the lower number
    best = np.full(weights.shape[1], -1, np.int64)
    best[pairs[order] // width] = pairs[order] % width - 1  # the last one of each stays
    return best


def _sums(at: Indices, thing: Indices, weight: np.ndarray) -> tuple[OtherIndices, OtherIndices, OtherDoubles]:
    """Return the sum of weights of each pair of numbers, pairs ascending."""
    width = int(thing.max(initial=0)) + 1
    keys, place = np.unique(at * width + thing, return_inverse=True)
    return keys // width, keys % width, np.bincount(place, weight)
