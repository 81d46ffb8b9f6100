"""Join pieces into the things that they are pieces of: what no mask holds, but stands out from all around it as one.

A thing of many colours is found in pieces where masks end at colours. Photos still show that the pieces are one
surface: at the borders between them depth goes on, and around all of them it jumps. See docs/grouping.md.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import combinations
from math import fsum
from typing import NamedTuple

import numpy as np

from ...base.arrays import Bool, Float32, Int64
from ..forest import PART, THING
from .borders import Borders
from .choosing import NONE, Tree, _above, _owners
from .standing_out import Outlines, PieceSet, grown, refined

MIN_RELIEF, MIN_GAIN = 0.7, 0.1  # of a thing, and over the mean of its pieces by area
WHOLE_SURENESS = 0.6  # of what single masks hold as a whole, which is not joined
ALONE_RELIEF = 0.85  # of a piece that stands out by itself, which is not joined
FINISHED_SHARE = 0.8  # of a set: a piece of so much that stands out by itself is a thing, with things on it
LARGE_SHARE = 0.02  # of a set: pieces of so much may not stand out more than all of it
MAX_SETS_UNITED = 16
MIN_AREA_PIXELS = 200  # over all photos, of a piece that a set is grown from


class Joined(NamedTuple):
    """members: numbers of the pieces of a thing, two or more, ascending. relief: of all of them together."""

    members: list[int]
    relief: float


def join(found: Borders, sure: Float32[np.ndarray, " n"]) -> list[Joined]:
    """Return the disjoint sets of pieces that are one thing, by their first pieces.

    From each piece, large ones first, a set is grown and refined (`standing_out`), and so are unions of the best sets.
    Those that are one thing are taken by how much more they stand out than their pieces do, times their area. sure: how
    well single masks fit each piece; pieces that masks hold as a whole (`WHOLE_SURENESS`) or that stand out by
    themselves (`ALONE_RELIEF`) are left as they are, also small ones that lie on a thing and hide some of its outline.
    """
    outlines = Outlines.of(found)
    free = (sure < WHOLE_SURENESS) & (outlines.reliefs < ALONE_RELIEF)
    candidates = _Candidates(outlines, free)
    for seed in np.argsort(-outlines.areas, kind="stable").tolist():
        if free[seed] and outlines.areas[seed] >= MIN_AREA_PIXELS:
            candidates.add(grown(outlines, seed, free))
    for one, other in combinations(
        candidates.best(MAX_SETS_UNITED), 2
    ):  # a head and a body, each the best around itself
        candidates.add(np.union1d(one.members, other.members))
    taken, joined = np.zeros(len(free), bool), []
    for best in candidates.best():
        members = np.array(best.members)[free[best.members]]
        if not taken[members].any():
            taken[members] = True
            joined.append(Joined(members.tolist(), best.relief))
    return sorted(joined)


class _Candidates:
    """Sets of pieces that are one thing, by how much more they stand out than their pieces do, times their area."""

    def __init__(self, outlines: Outlines, free: Bool[np.ndarray, " n"]) -> None:
        self.outlines, self.free = outlines, free
        self.found: dict[tuple[int, ...], tuple[float, float]] = {}  # what a set is worth, and its relief

    def add(self, members: Int64[np.ndarray, " k"]) -> None:
        """Refine a set, and keep it if it is one thing."""
        covered = refined(self.outlines, members, self.free)
        if self._is_thing(covered):
            self.found[tuple(covered.members.tolist())] = self._gain(covered) * covered.area, covered.relief

    def best(self, count: int | None = None) -> list[Joined]:
        """Return the sets that are worth most, or all; of equal ones the one with the lowest numbers first."""
        ordered = sorted(self.found, key=lambda members: (-self.found[members][0], members))
        return [Joined(list(members), self.found[members][1]) for members in ordered[:count]]

    def _gain(self, covered: PieceSet) -> float:
        """Return how much more a set stands out than its pieces do, in the mean by area; the same bits anywhere."""
        members = covered.members
        return covered.relief - fsum(self.outlines.reliefs[members] * self.outlines.areas[members]) / covered.area

    def _is_thing(self, covered: PieceSet) -> bool:
        members = covered.members[self.free[covered.members]]
        reliefs, shares = self.outlines.reliefs[members], self.outlines.areas[members] / covered.area
        finished = (shares >= FINISHED_SHARE) & (reliefs >= MIN_RELIEF)
        return (
            len(members) > 1
            and covered.relief >= MIN_RELIEF
            and covered.holds
            and self._gain(covered) >= MIN_GAIN
            and not finished.any()
            and not (reliefs[shares >= LARGE_SHARE] > covered.relief).any()
        )


def with_joined(tree: Tree, found: list[Joined]) -> Tree:
    """Return the tree with a thing above the things of each set, which are its parts from now on.

    found: numbers of things in the order of their nodes. Groups that hold some of a set and not all of it go, as do
    those that hold nothing else. A joined thing is as sure as its relief.
    """
    if not found:
        return tree
    (things,) = np.nonzero(tree.levels == THING)
    sets = [things[joined.members] for joined in found]
    crossed = _crossed(tree, things, sets)
    up = _above(tree.parents, ~crossed)
    old, new = len(tree.parents), len(sets)
    parents, levels = np.append(up, [up[members[0]] for members in sets]), np.append(tree.levels, np.full(new, THING))
    for number, members in enumerate(sets, old):
        parents[members], levels[members] = number, PART
    sure = np.append(tree.sure, [joined.relief for joined in found])
    after = np.append(np.arange(old), [members.max() + 0.5 for members in sets])  # all that is in them
    order = np.argsort(after, kind="stable")
    order = order[~np.append(crossed, np.zeros(new, bool))[order]]
    place = np.full(old + new + 1, NONE)  # the last one is that of -1
    place[order] = np.arange(len(order))
    node_of = place[np.append(_owners(tree.parents, ~crossed), NONE)[tree.node_of]]
    return Tree(
        node_of.astype(np.int32), place[parents[order]].astype(np.int32), levels[order].astype(np.uint8),
        sure[order].astype(np.float32),
    )  # fmt: skip


def _crossed(tree: Tree, things: Int64[np.ndarray, " o"], sets: list[np.ndarray]) -> Bool[np.ndarray, " t"]:
    """Mark groups that hold some of a set and not all of it, or nothing but a set."""
    parents, crossed = tree.parents.tolist(), np.zeros(len(tree.parents), bool)
    held = Counter(group for thing in things.tolist() for group in _groups(parents, thing))
    for members in sets:
        of_set = Counter(group for member in members.tolist() for group in _groups(parents, member))
        crossed[[group for group, count in of_set.items() if count < len(members) or count == held[group]]] = True
    return crossed


def _groups(parents: list[int], node: int) -> Iterator[int]:
    while (node := parents[node]) >= 0:
        yield node
