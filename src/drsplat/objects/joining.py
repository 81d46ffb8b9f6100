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
from .pairing import paired
from .sides import MOST, SHORT, Outline, Side, outline_of, sides_of, united

GAIN, RELIEF = 0.1, 0.7  # of relief over that of the pieces, and least
FINISHED = 0.8  # of the pixels of a join: a piece of so much that stands out by itself is a thing, with things on it
LARGE = 0.1  # of the pixels of a join: pieces that may not stand out more than all together
WHOLE = 0.6  # sureness of what single masks hold as a whole
GOES_ON = 0.5  # of a border, without a jump
LEAST = 0.02  # of both outlines that two pieces share: less is a touch


class Joined(NamedTuple):
    """members: numbers of the pieces of a thing, two or more. relief: of them together."""

    members: list[int]
    relief: float


def join(found: Borders, sure: Float32[np.ndarray, " n"]) -> list[Joined]:
    """The pieces that are one thing, at the finest of TOLERANCES first, and the things that are one (`paired`) last.

    A set of pieces is one thing where it stands out (`RELIEF`) by `GAIN` more than its pieces do on average, and by no
    less than each large one of them. sure: of each piece how well single masks fit it; those that are `WHOLE` stay
    what they are: where one is large nothing is joined, and small ones are left out.
    """
    total = len(found.areas)
    roots, reliefs = np.arange(total), np.zeros(total)
    for k in range(len(TOLERANCES) + 1):
        names, numbers = np.unique(roots, return_inverse=True)
        areas = np.bincount(numbers, found.areas, len(names)).astype(np.float64)  # of nothing, it counts whole numbers
        whole = (np.bincount(numbers, minlength=len(names)) == 1) & (sure[names] >= WHOLE)
        if k < len(TOLERANCES):
            sets = list(_standing_out(_merged(found, numbers, k, len(names)), areas, whole))
        else:
            sets = paired(sides_of(found, numbers, k - 1), areas, whole)
        for members, relief in sets:
            roots[np.isin(numbers, members)] = names[members[0]]
            reliefs[names[members[0]]] = relief
    order = np.argsort(roots, kind="stable")
    starts = np.flatnonzero(np.diff(roots[order], prepend=NONE))
    joined = [part[_is_piece(part, found.areas, sure)] for part in np.split(order, starts[1:])] if total else []
    return [Joined(part.tolist(), float(reliefs[roots[part[0]]])) for part in joined if len(part) > 1]


def _is_piece(
    members: Int64[np.ndarray, " k"], areas: Int64[np.ndarray, " n"], sure: Float32[np.ndarray, " n"]
) -> Bool[np.ndarray, " k"]:
    """Not so are small things on a thing, which masks hold as a whole."""
    return np.asarray((areas[members] >= LARGE * areas[members].sum()) | (sure[members] < WHOLE))


class _Node(NamedTuple):
    children: tuple[int, ...]
    outline: Outline


def _merged(found: Borders, numbers: Int64[np.ndarray, " n"], tolerance: int, total: int) -> list[_Node]:
    """The forest of merges, children first: best are those that share most of both outlines, where depth goes on."""
    sides = sides_of(found, numbers, tolerance)
    nodes = [_Node((), outline_of(sides.get(node, {}))) for node in range(total)]
    heap = [entry for one in sides for other in sides[one] if one < other for entry in _entry(nodes, sides, one, other)]
    heapify(heap)
    while heap:
        _, one, other = heappop(heap)
        if one in sides and other in sides:  # neither is part of another by now
            new = len(nodes)
            sides[new] = united(sides, one, other, new)
            nodes.append(_Node((one, other), outline_of(sides[new])))
            for beside in sides[new]:
                for entry in _entry(nodes, sides, beside, new):
                    heappush(heap, entry)
    return nodes


def _entry(
    nodes: list[_Node], sides: dict[int, dict[int, Side]], one: int, other: int
) -> Iterator[tuple[float, int, int]]:
    """For the heap, best first, where the two may be merged."""
    side = sides[one][other]
    lengths = nodes[one].outline.length * nodes[other].outline.length
    shared = side.level / max(lengths**0.5, SHORT)
    if side.level > GOES_ON * sum(side) and shared >= LEAST:
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
