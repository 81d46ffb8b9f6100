"""Votes of photos on objects, by their hierarchies of regions: which pieces are one thing.

One photo cannot tell a print from the sheet that it is on; many can. Each photo's regions are registered, so that any
node of its tree is a sum of columns of W, and the best node for an object is found without drawing anything. See
docs/grouping.md.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from math import fsum
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Doubles, Flags, Float64, Indices
from ...scene.masks.region_tree import RegionTree
from ..evidence.evidence import Evidence, MaskIds
from ..forest import THING
from .choosing import Tree
from .describing import node_weights
from .joining import Joined, with_joined

MIN_SEEN_SHARE = 0.3  # of what the best photo shows of a set, from which on a photo votes
INSIDE_SHARE, MIN_FIT = 0.6, 0.6  # of a piece in a candidate; of a candidate with its pieces together
MAX_SETS = 1000  # that are voted on: those that most photos propose
MIN_WORTH, MIN_GAIN = 0.35, 0.03  # of a set, and over the mean of its pieces by weight
LARGE_SHARE = 0.1  # of a set: pieces of so much may not be worth more than all of it
MAX_SHARE = 0.35  # of all weight: what is more is the room
WORTH_DECIMALS = 6  # the last bits of sums depend on the processor
MAX_FRAMED = 0.05  # of the border of a set: what photos cut off is a surface
Set = tuple[int, ...]


class Vote(NamedTuple):
    """A photo's regions. weights: W of them, a row for each row of the field's evidence."""

    view_name: str
    tree: RegionTree
    weights: csr_array


Votes = Callable[[], Iterable[Vote]]


class Worth(NamedTuple):
    """Worth of sets of pieces, 0 to 1, as photos see it. framed: share of the border that is a photo's frame."""

    worth: Doubles
    framed: Doubles


def with_voted(tree: Tree, votes: Votes) -> Tree:
    """Return the tree with pieces joined that the photos say are one thing; they are its parts from now on.

    votes: yields the photos anew, each time that it is called.
    """
    (things,) = np.nonzero(tree.levels == THING)
    seen = np.array([_seen(tree, things, vote).sum(axis=1) for vote in votes()])
    sets = _proposed(tree, things, seen, votes)
    if not sets:
        return tree
    alone = [(thing,) for thing in range(len(things))]
    members = [*alone, *sets]
    rows = np.repeat(np.arange(len(members)), [len(one) for one in members])
    entries = np.ones(len(rows), np.float32), (rows, np.concatenate(members))
    both = worth_of(csr_array(entries, shape=(len(members), len(things))), tree, things, votes)
    pieces, found = (Worth(*(values[part] for values in both)) for part in (np.s_[: len(alone)], np.s_[len(alone) :]))
    return with_joined(tree, _chosen(sets, found, pieces, seen.sum(0)))


def worth_of(sets: csr_array, tree: Tree, things: Indices, votes: Votes) -> Worth:
    """Return what sets of things are worth, (s, t) of 0 and 1.

    It is the median, over the photos that see the set, of its IoU with the best candidate there, times the mean
    strength of the outlines of these candidates.
    """
    said = [_said(csr_array(sets @ _seen(tree, things, vote)), vote) for vote in votes()]
    seen, fits, outlines, framed = (np.array(values) for values in zip(*said, strict=True))
    sees = seen > MIN_SEEN_SHARE * seen.max(0)
    usual = np.zeros(sets.shape[0])
    some = sees.any(0)
    usual[some] = np.nanmedian(np.where(sees, fits, np.nan)[:, some], axis=0)
    counted = np.where(sees, fits, 0)
    total = np.maximum(counted.sum(0), 1e-9)
    worth, cut_off = usual * (counted * outlines).sum(0) / total, (counted * framed).sum(0) / total
    return Worth(*(np.round(values, WORTH_DECIMALS) for values in (worth, cut_off)))


def _seen(tree: Tree, things: Indices, vote: Vote) -> csr_array:
    """Return the weight of each thing in each region of a photo, (t, n)."""
    count = vote.weights.shape[1]
    masks = MaskIds((vote.view_name,), np.zeros(count, np.int32), np.arange(count, dtype=np.int32))
    return csr_array(node_weights(Evidence(vote.weights, masks, np.ones((count, 1), np.float32)), tree)[things])


def _said(own: csr_array, vote: Vote) -> tuple[np.ndarray, ...]:
    """Return of each set how much a photo sees of it, its best IoU with a candidate, its outline, its framed share."""
    candidates, seen = vote.tree.candidates, own.sum(axis=1)
    if not candidates.shape[0]:
        return seen, *np.zeros((3, len(seen)))
    shared = (own @ candidates.T).toarray()
    fits = shared / np.maximum(seen[:, None] + candidates @ vote.weights.sum(axis=0) - shared, 1e-9)
    best = fits.argmax(1)
    return seen, fits.max(1), *(values[best] for values in vote.tree.bounds)


def _proposed(tree: Tree, things: Indices, seen: Float64[np.ndarray, "v n"], votes: Votes) -> list[Set]:
    """Return the sets of two or more things that candidates of photos hold, those of most photos first."""
    counts: Counter[Set] = Counter()
    for here, vote in zip(seen, votes(), strict=True):
        counts.update(set(_proposals(_seen(tree, things, vote), here, here > MIN_SEEN_SHARE * seen.max(0), vote)))
    return sorted(counts, key=lambda one: (-counts[one], one))[:MAX_SETS]


def _proposals(own: csr_array, seen: Doubles, sees: Flags, vote: Vote) -> Iterator[Set]:
    candidates = vote.tree.candidates
    shared = (own @ candidates.T).toarray()
    within = (shared > INSIDE_SHARE * seen[:, None]) & sees[:, None]
    both = (shared * within).sum(0)
    either = candidates @ vote.weights.sum(axis=0) + (seen[:, None] * within).sum(0) - both
    good = (both > MIN_FIT * either) & (within.sum(0) > 1) & (vote.tree.bounds.framed <= MAX_FRAMED)
    for column in np.flatnonzero(good):
        yield tuple(np.flatnonzero(within[:, column]).tolist())


def _chosen(sets: list[Set], found: Worth, pieces: Worth, weight: Doubles) -> list[Joined]:
    """Return the disjoint sets that are one thing, those of most weight times gain first."""
    gains: list[tuple[float, int]] = []
    for number, (one, worth, framed) in enumerate(zip(sets, *found, strict=True)):
        members = np.array(one)
        shares = weight[members] / weight[members].sum()
        gain = float(worth) - fsum(shares * pieces.worth[members])
        stronger = (pieces.worth[members] > worth) & (shares >= LARGE_SHARE)
        small = weight[members].sum() <= MAX_SHARE * weight.sum()
        if small and worth >= MIN_WORTH and gain >= MIN_GAIN and framed <= MAX_FRAMED and not stronger.any():
            gains.append((-gain * float(weight[members].sum()), number))
    taken: set[int] = set()
    joined = []
    for _, number in sorted(gains):
        if taken.isdisjoint(sets[number]):
            taken.update(sets[number])
            joined.append(Joined(list(sets[number]), float(found.worth[number])))
    return sorted(joined)
