"""From pieces to what they are pieces of: what no mask holds as a whole, but stands out from all around it as one.

A thing of many colours is found in pieces where masks end at colours. Photos still show that the pieces are one
surface: at the borders between them depth goes on, and around all of them it jumps. See docs/objects.md.
"""

from collections import Counter
from collections.abc import Iterator
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from ..field.objects import PART, THING
from .borders import TOLERANCES, Borders
from .choosing import NONE, Tree, _above, _owners

GAIN, RELIEF = 0.1, 0.7  # of relief over that of the pieces, and least
FINISHED = 0.8  # of the pixels of a join: a piece of so much that stands out by itself is a thing, with things on it
LARGE = 0.1  # of the pixels of a join: pieces that may not stand out more than all together
WHOLE = 0.6  # sureness of what single masks hold as a whole
MOST = 0.5  # of all pixels: what has more is the room
GOES_ON = 0.5  # of a border, without a jump
LEAST = 0.02  # of both outlines that two pieces share: less is a touch
FEW = 30  # pixels of border that a relief is held against
SHORT = 20  # pixels: shorter outlines count as that


class Joined(NamedTuple):
    """members: numbers of the pieces of a thing, two or more. relief: of them together."""

    members: list[int]
    relief: float


class _Outline(NamedTuple):
    """Pixels of the border of a node with others: where it is in front, where depth goes on, and all."""

    front: float
    level: float
    length: float

    @property
    def relief(self) -> float:
        """The share of its border where a node stands in front of what is beside it; behind counts for neither."""
        return self.front / (self.front + self.level + FEW)


def join(found: Borders, sure: Float32[np.ndarray, " n"]) -> list[Joined]:
    """The pieces that are one thing, at the finest of TOLERANCES first.

    A set of pieces is one thing where it stands out (`RELIEF`) by `GAIN` more than its pieces do on average, and by no
    less than each large one of them. sure: of each piece how well single masks fit it; those that are `WHOLE` stay
    what they are: where one is large nothing is joined, and small ones are left out.
    """
    total = len(found.areas)
    roots, reliefs = np.arange(total), np.zeros(total)
    for k in range(len(TOLERANCES)):
        names, numbers = np.unique(roots, return_inverse=True)
        nodes = _merged(found, numbers, k, len(names))
        areas = np.bincount(numbers, found.areas, len(names))
        single = np.bincount(numbers, minlength=len(names)) == 1
        for members, relief in _standing_out(nodes, areas, single & (sure[names] >= WHOLE)):
            roots[np.isin(numbers, members)] = names[members[0]]
            reliefs[names[members[0]]] = relief
    order = np.argsort(roots, kind="stable")
    starts = np.flatnonzero(np.diff(roots[order], prepend=NONE))
    sets = [part[_is_piece(part, found.areas, sure)] for part in np.split(order, starts[1:])] if total else []
    return [Joined(part.tolist(), float(reliefs[roots[part[0]]])) for part in sets if len(part) > 1]


def _is_piece(
    members: Int64[np.ndarray, " k"], areas: Int64[np.ndarray, " n"], sure: Float32[np.ndarray, " n"]
) -> Bool[np.ndarray, " k"]:
    """Not so are small things on a thing, which masks hold as a whole."""
    return np.asarray((areas[members] >= LARGE * areas[members].sum()) | (sure[members] < WHOLE))


class _Node(NamedTuple):
    children: tuple[int, ...]
    outline: _Outline


def _merged(found: Borders, numbers: Int64[np.ndarray, " n"], tolerance: int, total: int) -> list[_Node]:
    """The forest of merges, children first: best are those that share most of both outlines, where depth goes on."""
    sides = _sides(found, numbers, tolerance)
    nodes = [_Node((), _outline(sides.get(node, {}))) for node in range(total)]
    heap = [entry for one in sides for other in sides[one] if one < other for entry in _entry(nodes, sides, one, other)]
    heapify(heap)
    while heap:
        _, one, other = heappop(heap)
        if one in sides and other in sides:  # neither is part of another by now
            new = len(nodes)
            sides[new] = _united(sides, one, other, new)
            nodes.append(_Node((one, other), _outline(sides[new])))
            for beside in sides[new]:
                for entry in _entry(nodes, sides, beside, new):
                    heappush(heap, entry)
    return nodes


_Side = tuple[int, int, int]  # pixels: in front, level, behind


def _sides(found: Borders, numbers: Int64[np.ndarray, " n"], tolerance: int) -> dict[int, dict[int, _Side]]:
    """By node and neighbour the border between them, seen from the node."""
    sides: dict[int, dict[int, _Side]] = {}
    fronts, backs = numbers[found.front].tolist(), numbers[found.back].tolist()
    levels = found.counts[:, tolerance].tolist()
    for front, back, level, length in zip(fronts, backs, levels, found.counts[:, -1].tolist(), strict=True):
        if front != back:
            jumps = length - level
            _add(sides.setdefault(front, {}), back, (jumps, level, 0))
            _add(sides.setdefault(back, {}), front, (0, level, jumps))
    return sides


def _add(sides: dict[int, _Side], node: int, more: _Side) -> None:
    known = sides.get(node, (0, 0, 0))
    sides[node] = (known[0] + more[0], known[1] + more[1], known[2] + more[2])


def _united(sides: dict[int, dict[int, _Side]], one: int, other: int, new: int) -> dict[int, _Side]:
    """The sides of two nodes as those of a new one, which their neighbours know from now on instead."""
    united: dict[int, _Side] = {}
    for old in (one, other):
        for beside, side in sides.pop(old).items():
            if beside in (one, other):
                continue
            _add(united, beside, side)
            _add(sides[beside], new, sides[beside].pop(old))
    return united


def _outline(sides: dict[int, _Side]) -> _Outline:
    front, level, behind = (sum(side[k] for side in sides.values()) for k in range(3))
    return _Outline(front, level, front + level + behind)


def _entry(
    nodes: list[_Node], sides: dict[int, dict[int, _Side]], one: int, other: int
) -> Iterator[tuple[float, int, int]]:
    """For the heap, best first, where the two may be merged."""
    side = sides[one][other]
    lengths = nodes[one].outline.length * nodes[other].outline.length
    shared = side[1] / max(lengths**0.5, SHORT)
    if side[1] > GOES_ON * sum(side) and shared >= LEAST:
        yield -shared, one, other


class _Leaf(NamedTuple):
    relief: float
    size: float
    is_whole: bool


def _standing_out(
    nodes: list[_Node], areas: Float64[np.ndarray, " n"], whole: Bool[np.ndarray, " n"]
) -> Iterator[tuple[list[int], float]]:
    """The leaves of the nodes that are things, none of them within another, with their relief."""
    sizes, worth = areas.tolist(), [node.outline.relief * area for node, area in zip(nodes, areas, strict=False)]
    large = [[_Leaf(nodes[leaf].outline.relief, sizes[leaf], bool(whole[leaf]))] for leaf in range(len(sizes))]
    most, is_thing = MOST * sum(sizes), [False] * len(nodes)
    for number, (children, outline) in enumerate(nodes[len(sizes) :], len(sizes)):
        size = sum(sizes[child] for child in children)
        within = [leaf for child in children for leaf in large[child] if leaf.size >= LARGE * size]
        apart, together = sum(worth[child] for child in children), outline.relief * size
        is_thing[number] = (
            size <= most
            and outline.relief > RELIEF
            and together > apart + GAIN * size
            and all(leaf.relief <= outline.relief and not leaf.is_whole for leaf in within)
            and not any(leaf.size >= FINISHED * size and leaf.relief >= RELIEF for leaf in within)
        )
        sizes.append(size)
        large.append(within)
        worth.append(together if is_thing[number] else apart)
    inner = {child for node in nodes for child in node.children}
    left = [number for number in range(len(nodes)) if number not in inner]
    while left:
        number = left.pop()
        if is_thing[number]:
            yield sorted(_leaves(nodes, number)), nodes[number].outline.relief
        else:
            left.extend(nodes[number].children)


def _leaves(nodes: list[_Node], number: int) -> Iterator[int]:
    left = [number]
    while left:
        node = left.pop()
        if not nodes[node].children:
            yield node
        left.extend(nodes[node].children)


def with_joined(tree: Tree, found: list[Joined]) -> Tree:
    """The tree with a thing above the things of each set, which are its parts from now on.

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
    """Groups that hold some of a set and not all of it, or nothing but a set."""
    parents, crossed = tree.parents.tolist(), np.zeros(len(tree.parents), bool)
    held = Counter(group for thing in things.tolist() for group in _groups(parents, thing))
    for members in sets:
        of_set = Counter(group for member in members.tolist() for group in _groups(parents, member))
        crossed[[group for group, count in of_set.items() if count < len(members) or count == held[group]]] = True
    return crossed


def _groups(parents: list[int], node: int) -> Iterator[int]:
    while (node := parents[node]) >= 0:
        yield node
