"""Answers of whole objects, from the values of their Gaussians."""

from collections.abc import Iterator

import numpy as np

from ..base.arrays import Embedding, Ids, Indices, Numbers, OtherIds, UnsignedIds, WholeNumbers
from ..field import LanguageField
from ..kernels.algebra import row_products

SPEAKING_SHARE = 0.25  # of an object's Gaussians
ROWS_AT_ONCE = 1 << 18
OBJECT_TRUST = 0.5  # in what an object says against what a Gaussian of it says


def by_object(field: LanguageField, values: Numbers) -> Numbers:
    """Return values per row of a field `with_objects`; one that has none gives the values themselves."""
    if field.objects is None:
        return values
    return with_objects(values, field.objects.thing_of(), field.objects.piece_of())


def with_objects(values: Numbers, things: Ids, pieces: Ids, counts: WholeNumbers | None = None) -> Numbers:
    """Return per row the mean of its own value and its object's; loose rows, of thing -1, keep their own.

    counts: rows that each stands for, None for one.

    An object's value is the one that `SPEAKING_SHARE` of its rows reach: what single photos say of the rest is noise,
    most of it where masks end. A row that fits far worse than the object stays out nevertheless: objects of real photos
    hold pieces of what is beside them. Where its piece of the object has a higher value than the object that counts, so
    that "bow" finds the bow of a doll; pieces: -1 for none. No row's value depends on another object, so no scrap that
    fits well by chance hides a thing.
    """
    spoken = highest_share(values, things, counts)
    if (pieces >= 0).any():
        spoken = np.where(pieces >= 0, np.maximum(spoken, highest_share(values, pieces, counts)), spoken)
    whole = np.float32(1 - OBJECT_TRUST) * values + np.float32(OBJECT_TRUST) * spoken
    return np.where(things >= 0, whole, values)


def for_comparing(field: LanguageField, values: Numbers, query: Embedding | None = None) -> Numbers:
    """Return values per row by which classes are compared, of which one has to be the best: an object has its mean.

    Of cosines, with their unit query, it is the mean of that and of the cosine with the object's best descriptor, which
    the masks that hold nothing else have most part in. Of a thing that is nothing but its parts, as what was joined
    from pieces is, each part chooses for itself: one surface may be of two classes. Loose rows keep their own.
    """
    if field.objects is None or not len(values):
        return values
    numbers = field.objects.single_of() + 1  # 0: loose
    count = field.objects.num_nodes + 1
    means = np.bincount(numbers, values, minlength=count) / np.maximum(np.bincount(numbers, minlength=count), 1)
    if query is not None:
        # per node the highest cosine of a query with one of its descriptors
        cosines = row_products(field.objects.descriptors, query / np.linalg.norm(query))
        starts = field.objects.descriptor_starts
        best = np.full(field.objects.num_nodes, -1, np.float32)
        (some,) = np.nonzero(np.diff(starts))
        if len(some):
            best[some] = np.maximum.reduceat(cosines, starts[some])
        means[1:] = (means[1:] + best) / 2
    return np.where(numbers > 0, means.astype(np.float32)[numbers], values)


def highest_share(values: Numbers, groups: Ids, counts: WholeNumbers | None = None) -> Numbers:
    """Return per row the value that `SPEAKING_SHARE` of the rows of its group reach; rows of group -1 keep their own.

    counts: rows that each stands for, None for one. Linear but for one sort. Values have to be finite. Twin:
    tests/query/test_objects_asked.py::slow_by_object.
    """
    result, lengths = values.copy(), _lengths(groups)
    for first, last in _runs(lengths):
        (inside,) = np.nonzero((groups >= first) & (groups < last))
        if not len(inside):
            continue
        own = groups[inside] - first
        keys = own.astype(np.uint64) << np.uint64(32) | _descending(values[inside])
        if counts is None:
            keys, sizes = np.sort(keys), lengths[first:last]
            ends = np.arange(1, len(keys) + 1)
        else:
            order = np.argsort(keys)
            keys, ends = keys[order], np.cumsum(counts[inside][order], dtype=np.int64)
            sizes = np.bincount(own, counts[inside], last - first).astype(np.int64)
        reached = np.cumsum(sizes) - sizes + np.ceil(SPEAKING_SHARE * sizes).astype(np.int64)
        best = _from_descending(keys[np.searchsorted(ends, reached)].astype(np.uint32))
        result[inside] = best[own]
    return result


def _lengths(groups: OtherIds) -> Indices:
    """Return how many rows each group has."""
    lengths = np.zeros(int(groups.max(initial=-1)) + 1, np.int64)
    for begin in range(0, len(groups), ROWS_AT_ONCE):
        some = groups[begin : begin + ROWS_AT_ONCE]
        lengths += np.bincount(some[some >= 0], minlength=len(lengths))
    return lengths


def _runs(lengths: Indices) -> Iterator[tuple[int, int]]:
    """Yield groups that follow each other and have ROWS_AT_ONCE rows together, or one that has more."""
    ends = np.cumsum(lengths)
    first = 0
    while first < len(lengths):
        before = int(ends[first] - lengths[first])
        last = max(first + 1, int(np.searchsorted(ends, before + ROWS_AT_ONCE, "right")))
        yield first, last
        first = last


_SIGN_BIT = np.uint32(1 << 31)


def _descending(values: Numbers) -> UnsignedIds:
    """Return numbers that fall as values rise. Floats are sign and magnitude: their bits rise with the magnitude."""
    bits = values.view(np.uint32)
    return np.where(bits & _SIGN_BIT, bits, ~(bits | _SIGN_BIT))


def _from_descending(numbers: UnsignedIds) -> Numbers:
    """Return the values of which `_descending` made numbers."""
    return np.where(numbers & _SIGN_BIT, numbers, ~numbers & ~_SIGN_BIT).view(np.float32)
