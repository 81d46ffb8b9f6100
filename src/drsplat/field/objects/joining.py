"""Join pieces into the things that they are pieces of: what no mask holds, but stands out from all around it as one.

A thing of many colours is found in pieces where masks end at colours. Photos still show that the pieces are one
surface: at the borders between them depth goes on, and around all of them it jumps. See docs/grouping.md.

*Relief* of a set is the share of its outline at which it stands in front of what is beside it; where it is behind
something else nobody knows how it goes on, and that counts for neither side. Borders within the set do not count.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise
from math import fsum
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Arrays, Bool, Doubles, Flags, Float64, Indices, Numbers, OtherFlags
from ...base.working import HERE, Held, Work
from ..forest import PART, THING, owner_nodes
from .borders import Borders
from .choosing import NONE, Tree, _above

PixelSums = Float64[np.ndarray, " *s"]

MIN_RELIEF, MIN_GAIN = 0.7, 0.1  # of a thing, and over the mean of its pieces by area
WHOLE_SURENESS = 0.6  # of what single masks hold as a whole, which is not joined
ALONE_RELIEF = 0.85  # of a piece that stands out by itself, which is not joined
FINISHED_SHARE = 0.8  # of a set: a piece of so much that stands out by itself is a thing, with things on it
LARGE_SHARE = 0.02  # of a set: pieces of so much may not stand out more than all of it
MAX_SETS_UNITED = 16
SEEDS_AT_ONCE = 64
MIN_AREA_PIXELS = 200  # over all photos, of a piece that a set is grown from
MIN_LEVEL_SHARE = 0.5  # of the borders within a set: depth goes on along so many
RELIEF_PRIOR_PIXELS = 30  # of outline that does not stand out, added to every outline
MAX_PIECES = 100  # of a thing
MAX_AREA_SHARE = 0.5  # of the area of all pieces: what has more is the room
MAX_SMALL_SHARE = 0.1  # of a set: what is no piece of it may lie on it up to this size
RELIEF_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Outlines:
    """Pieces and the borders between all of them, in pixels over all photos; whole numbers, so that sums are exact.

    areas: of each piece. front: (n, n), where the piece of a row is in front of that of a column, depth jumping between
    them. back: its transpose. level: (n, n), symmetric, where depth goes on. sure: how well single masks fit each.
    """

    areas: Doubles
    front: csr_array
    back: csr_array
    level: csr_array
    sure: Numbers

    @classmethod
    def of(cls, found: Borders, sure: Numbers) -> "Outlines":
        """Return the outlines of pieces whose borders were found in photos."""
        shape = (len(found.areas),) * 2
        level = csr_array((found.levels.astype(np.float64), (found.front, found.back)), shape=shape)
        front = csr_array(((found.lengths - found.levels).astype(np.float64), (found.front, found.back)), shape=shape)
        return cls(found.areas.astype(np.float64), front, csr_array(front.T), csr_array(level + level.T), sure)

    @cached_property
    def fronts(self) -> Doubles:
        """Pixels of its outline where each piece is in front."""
        return np.asarray(self.front.sum(axis=1)).ravel()

    @cached_property
    def levels(self) -> Doubles:
        """Pixels of its outline where depth goes on, of each piece."""
        return np.asarray(self.level.sum(axis=1)).ravel()

    @cached_property
    def reliefs(self) -> Doubles:
        """Relief of each piece alone."""
        return relief(self.fronts, self.levels)

    @cached_property
    def free(self) -> Flags:
        """Pieces that may be joined: neither masks hold them as a whole, nor do they stand out by themselves."""
        return (self.sure < WHOLE_SURENESS) & (self.reliefs < ALONE_RELIEF)

    @cached_property
    def largest(self) -> float:
        """Pixels that a set may have at most."""
        return MAX_AREA_SHARE * float(self.areas.sum())


class PieceSet:
    """A set of pieces that can be added to and taken from, with its outline and the borders within it.

    before, behind, beside: pixels of the border of each piece with the set where the piece is in front of the set,
    where it is behind the set, and where depth goes on.
    """

    def __init__(self, outlines: Outlines, members: Indices) -> None:
        self.outlines = outlines
        self.within = np.zeros(len(outlines.areas), bool)
        self.before, self.behind, self.beside = (np.zeros(len(self.within)) for _ in range(3))
        self.area = self.front = self.level = self.inner_front = self.inner_level = 0.0
        for piece in members.tolist():
            self.change(piece)

    @property
    def members(self) -> Indices:
        """Numbers of the pieces, ascending."""
        return np.flatnonzero(self.within)

    @property
    def relief(self) -> float:
        """Relief of all pieces together."""
        return float(relief(np.array(self.front), np.array(self.level)))

    @property
    def holds(self) -> bool:
        """True where depth goes on along enough of the borders within."""
        return bool(goes_on(np.array(self.inner_level), np.array(self.inner_front)))

    @property
    def gain(self) -> float:
        """How much more the set stands out than its pieces do, in the mean by area; the same bits anywhere."""
        reliefs, areas = self.outlines.reliefs[self.members], self.outlines.areas[self.members]
        return self.relief - fsum(reliefs * areas) / self.area

    @property
    def is_thing(self) -> bool:
        """True where the free pieces of the set are one thing."""
        members = self.members[self.outlines.free[self.members]]
        reliefs, shares = self.outlines.reliefs[members], self.outlines.areas[members] / self.area
        finished = (shares >= FINISHED_SHARE) & (reliefs >= MIN_RELIEF)
        return (
            len(members) > 1
            and self.relief >= MIN_RELIEF
            and self.holds
            and self.gain >= MIN_GAIN
            and not finished.any()
            and not (reliefs[shares >= LARGE_SHARE] > self.relief).any()
        )

    def changes(self) -> Indices:
        """Return the pieces that may be added or taken out: pieces of the set, and what depth goes on to from it.

        Free pieces may be added. Of others those that are small in the set may (`MAX_SMALL_SHARE`): a bow on a doll is
        whole by itself, and hides some of the doll's outline. Nothing is added that makes the set too large.
        """
        pieces = np.flatnonzero(self.within | (self.beside > 0))
        areas, within = self.outlines.areas[pieces], self.within[pieces]
        together = self.area + areas
        small = areas <= MAX_SMALL_SHARE * together
        return pieces[within | (self.outlines.free[pieces] | small) & (together <= self.outlines.largest)]

    def reliefs(self, pieces: Indices) -> Doubles:
        """Return the relief of the set once each piece alone is added to it, or taken out of it."""
        sign = self._signs(pieces)
        front = self.outlines.fronts[pieces] - self.behind[pieces] - self.before[pieces]
        level = self.outlines.levels[pieces] - 2 * self.beside[pieces]
        return relief(self.front + sign * front, self.level + sign * level)

    def holding(self, pieces: Indices) -> Flags:
        """Return for each of these sets whether depth goes on along enough of the borders within."""
        sign = self._signs(pieces)
        jumps = self.before[pieces] + self.behind[pieces]
        return goes_on(self.inner_level + sign * self.beside[pieces], self.inner_front + sign * jumps)

    def change(self, piece: int) -> None:
        """Add a piece, or take it out."""
        sign = -1.0 if self.within[piece] else 1.0
        before, behind, beside = self.before[piece], self.behind[piece], self.beside[piece]
        self.area += sign * float(self.outlines.areas[piece])
        self.front += sign * float(self.outlines.fronts[piece] - behind - before)
        self.level += sign * float(self.outlines.levels[piece] - 2 * beside)
        self.inner_front += sign * float(before + behind)
        self.inner_level += sign * float(beside)
        for sums, rows in (
            (self.before, self.outlines.back),
            (self.behind, self.outlines.front),
            (self.beside, self.outlines.level),
        ):
            part = slice(rows.indptr[piece], rows.indptr[piece + 1])
            sums[rows.indices[part]] += sign * rows.data[part]
        self.within[piece] ^= True

    def _signs(self, pieces: Indices) -> Doubles:
        return np.where(self.within[pieces], -1.0, 1.0)


class Joined(NamedTuple):
    """members: numbers of the pieces of a thing, two or more, ascending. relief: of all of them together."""

    members: list[int]
    relief: float


@dataclass(frozen=True, eq=False)
class Growing:
    """Grows things from pieces: a `Part`. borders: `Borders`, and how `sure` each piece is."""

    borders: Held

    @cached_property
    def outlines(self) -> Outlines:
        """Outlines of all pieces."""
        arrays = dict(self.borders.arrays)
        sure = arrays.pop("sure")
        return Outlines.of(Borders(**arrays), sure)

    def __call__(self, seeds: Indices, threads: int) -> Arrays:
        sets = (refined(self.outlines, grown(self.outlines, seed)) for seed in seeds.tolist())
        things = [one.members for one in sets if one.is_thing]
        ends = np.cumsum([0, *map(len, things)])
        return {"members": np.concatenate([np.empty(0, np.int64), *things]), "ends": ends}


def join(found: Borders, sure: Numbers, work: Work = HERE) -> list[Joined]:
    """Return the disjoint sets of pieces that are one thing, by their first pieces.

    From each piece, large ones first, a set is grown and refined, and so are unions of the best sets.
    Those that are one thing are taken by how much more they stand out than their pieces do, times their area. sure: how
    well single masks fit each piece; pieces that masks hold as a whole (`WHOLE_SURENESS`) or that stand out by
    themselves (`ALONE_RELIEF`) are left as they are, also small ones that lie on a thing and hide some of its outline.
    """
    growing = Growing(work.hold({**found._asdict(), "sure": sure}))
    outlines = growing.outlines
    things: dict[tuple[int, ...], tuple[float, float]] = {}

    def note(thing: PieceSet) -> None:
        things[tuple(thing.members.tolist())] = -thing.gain * thing.area, thing.relief

    def best() -> list[tuple[int, ...]]:
        """Return the things that are worth most first, of equal ones the one with the lowest numbers."""
        return sorted(things, key=lambda members: (things[members][0], members))

    seeds = np.flatnonzero(outlines.free & (outlines.areas >= MIN_AREA_PIXELS))
    for held in work(growing, np.array_split(seeds, -(-len(seeds) // SEEDS_AT_ONCE) or 1), "joining pieces"):
        for begin, end in pairwise(held.arrays["ends"].tolist()):
            note(PieceSet(outlines, held.arrays["members"][begin:end]))
    for one, other in combinations(best()[:MAX_SETS_UNITED], 2):  # a head and a body, each the best around itself
        union = refined(outlines, np.union1d(one, other))
        if union.is_thing:
            note(union)
    taken, joined = np.zeros(len(sure), bool), []
    for thing in best():
        members = np.array(thing)[outlines.free[list(thing)]]
        if not taken[members].any():
            taken[members] = True
            joined.append(Joined(members.tolist(), things[thing][1]))
    return sorted(joined)


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
    node_of = place[np.append(owner_nodes(tree.parents, ~crossed), NONE)[tree.node_of]]
    return Tree(
        node_of.astype(np.int32), place[parents[order]].astype(np.int32), levels[order].astype(np.uint8),
        sure[order].astype(np.float32),
    )  # fmt: skip


def _crossed(tree: Tree, things: Indices, sets: list[np.ndarray]) -> OtherFlags:
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


def relief(front: PixelSums, level: PixelSums) -> PixelSums:
    """Return the relief of an outline, from its pixels in front and those where depth goes on; near 0 for a few."""
    return np.asarray(front / (front + level + RELIEF_PRIOR_PIXELS))


def goes_on(level: PixelSums, front: PixelSums) -> Bool[np.ndarray, " *s"]:
    """Return whether borders hold a set together, from their pixels where depth goes on and where it jumps."""
    return np.asarray(level >= MIN_LEVEL_SHARE * (level + front))


def grown(outlines: Outlines, seed: int) -> Indices:
    """Return the set that stands out most of those that come about as pieces are added to a seed, best first.

    Each time the neighbour is added with which the set stands out most, also where that is less than before: a thing
    of many pieces stands out little until most of it is there. Along half of the borders within the returned set depth
    goes on (`MIN_LEVEL_SHARE`).
    """
    growing = PieceSet(outlines, np.array([seed]))
    order, best, length = [seed], growing.relief, 1
    while len(order) < MAX_PIECES:
        pieces = growing.changes()
        pieces = pieces[~growing.within[pieces]]
        if not len(pieces):
            break
        piece = int(pieces[growing.reliefs(pieces).argmax()])
        growing.change(piece)
        order.append(piece)
        if growing.relief > best and growing.holds:
            best, length = growing.relief, len(order)
    return np.sort(np.array(order[:length]))


def refined(outlines: Outlines, members: Indices) -> PieceSet:
    """Return the set once no single piece added or taken out lets it stand out more; every step is the best one.

    No step is taken after which depth does not go on along half of the borders within.
    """
    growing = PieceSet(outlines, members)
    for _ in range(4 * MAX_PIECES):
        pieces = growing.changes()
        if np.count_nonzero(growing.within) == 1:
            pieces = pieces[~growing.within[pieces]]
        pieces = pieces[growing.holding(pieces)]
        reliefs = growing.reliefs(pieces)
        if not len(pieces) or reliefs.max() <= growing.relief + RELIEF_TOLERANCE:
            break
        growing.change(int(pieces[reliefs.argmax()]))
    return growing
