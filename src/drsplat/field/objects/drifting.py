"""Gaussians that change what they belong to over time: at each time clear, over all of them not."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Float64, Int64, Integer
from ...errors import InputError
from .. import LanguageField
from ..evidence.aggregation.entries import entry_rows

OfDrifting = Int64[np.ndarray, " g"]
CLEAR_SHARE = 0.8  # of a Gaussian's weight in masks of one object


class Drifting(NamedTuple):
    """Gaussians whose masks name different objects at different times.

    gaussian_ids: rows of the scene, ascending. shares: for each, the largest share that one object has of it over
    all times. first, last: the objects that it belongs to at the first and the last time that it is seen, -1 for what
    is of none.
    """

    gaussian_ids: OfDrifting
    shares: Float64[np.ndarray, " g"]
    first: OfDrifting
    last: OfDrifting


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
    rows = entry_rows(weights)
    at = rows * len(stamps) + when[masks.views[weights.indices]]
    return _judged(field, _sums(at, owner[weights.indices] + 1, weights.data), len(stamps))


class _Sums(NamedTuple):
    """Weights of Gaussians in objects (number + 1) at times; `at` is row times number of times plus time."""

    at: Int64[np.ndarray, " e"]
    thing: Int64[np.ndarray, " e"]
    weight: Float64[np.ndarray, " e"]


def _owners(weights: csr_array, thing_of: Integer[np.ndarray, " r"]) -> Int64[np.ndarray, " m"]:
    """Return the object that has most of each mask's weight, -1 for none."""
    rows = np.repeat(thing_of.astype(np.int64) + 1, np.diff(weights.indptr))
    width = int(rows.max(initial=0)) + 1
    pairs, place = np.unique(weights.indices.astype(np.int64) * width + rows, return_inverse=True)
    sums = np.bincount(place, weights.data)
    order = np.lexsort((-(pairs % width), sums, pairs // width))  # of equal ones the lower number
    best = np.full(weights.shape[1], -1, np.int64)
    best[pairs[order] // width] = pairs[order] % width - 1  # the last one of each stays
    return best


def _sums(at: Int64[np.ndarray, " w"], thing: Int64[np.ndarray, " w"], weight: np.ndarray) -> _Sums:
    width = int(thing.max(initial=0)) + 1
    keys, place = np.unique(at * width + thing, return_inverse=True)
    return _Sums(keys // width, keys % width, np.bincount(place, weight))


def _judged(field: LanguageField, sums: _Sums, num_times: int) -> Drifting:
    rows, width = sums.at // num_times, int(sums.thing.max(initial=0)) + 1
    totals = np.maximum(np.bincount(rows, sums.weight, minlength=len(field)), np.finfo(np.float64).tiny)
    known, of = np.unique(sums.at, return_inverse=True)
    heaviest = np.zeros(len(known))
    np.maximum.at(heaviest, of, sums.weight)
    clear = np.bincount(known // num_times, heaviest, minlength=len(field)) / totals
    pairs, place = np.unique(rows * width + sums.thing, return_inverse=True)
    overall = np.zeros(len(field))
    np.maximum.at(overall, pairs // width, np.bincount(place, sums.weight))
    shares = overall / totals
    (found,) = np.nonzero((clear >= CLEAR_SHARE) & (shares < CLEAR_SHARE))
    strongest = sums.thing[np.lexsort((sums.weight, sums.at))][np.cumsum(np.bincount(of)) - 1]  # of each time
    begin = np.searchsorted(known, found * num_times)
    end = np.searchsorted(known, (found + 1) * num_times) - 1
    return Drifting(field.gaussian_ids[found].astype(np.int64), shares[found], strongest[begin] - 1, strongest[end] - 1)
