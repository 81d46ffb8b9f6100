"""Choice of parts, things and groups among the nodes of a forest of merges."""

from typing import NamedTuple

import numpy as np

from ...base.arrays import (
    ByteValues,
    Doubles,
    Flags,
    Ids,
    Indices,
    Numbers,
    OtherIds,
    OtherIndices,
    RowIds,
    WholeNumbers,
)
from ...kernels import Forest
from ..forest import GROUP, PART, THING, owner_nodes

APART_DISTANCE = 0.4  # of embeddings (1: unrelated) of regions that are never one thing
MAX_GROUP_SHARE = 0.5  # of all weight: what holds more is the room
MAX_SMALL_SHARE, MIN_SMALL_FIT = 0.1, 0.19  # of the size of what a small thing is on; its fit
SMALL_SIZE_POWER = 0.7  # weighs nodes where small things are looked for
NONE = -1


class Tree(NamedTuple):
    """The nodes that are kept, as in `Objects`. node_of: of each row. sure: how well masks of the photos fit a node."""

    node_of: OtherIds
    parents: Ids
    levels: ByteValues
    sure: Numbers


def choose(forest: Forest, node_of: RowIds, smallest: int) -> Tree:
    """Choose the hierarchy of parts, things and groups in a forest. node_of: a node of each row, -1 for none.

    Things are the disjoint nodes with the largest sum of weight times the root of fit; none merges regions whose
    embeddings are `APART_DISTANCE` apart. Small things on them are things of their own (`_small_things`), what is left
    of them another, and together they are a group. Parts are the best nodes within each thing, groups nodes above that
    hold several.
    """
    (judged,) = np.nonzero(forest.sizes >= smallest)  # what is above them is larger
    parents, sizes, fits = _within(forest.parents, judged), forest.sizes[judged], forest.fits[judged].astype(np.float64)
    worth, alike = forest.masses[judged] * np.sqrt(fits), forest.spreads[judged] <= APART_DISTANCE
    things = best_nodes(parents, np.where(alike, worth, NONE))
    small = _small_things(parents, sizes, np.where(alike, fits, 0), things)
    crowded = np.zeros(len(parents), bool)
    crowded[_above(parents, things)[small]] = True
    total = float(forest.masses[forest.parents < 0].sum(dtype=np.float64))
    groups = _several_branches(parents, things) & (forest.masses[judged] <= MAX_GROUP_SHARE * total)
    parts = _parts(parents, np.where(small | holding(parents, parents[small]), NONE, worth), things | small)
    levels = np.full(len(parents), NONE)
    for level, nodes in ((PART, parts), (THING, things | small), (GROUP, groups | crowded)):
        levels[nodes] = level
    kept = levels != NONE
    return _with_rests(_tree_of(forest, node_of, judged[kept], levels[kept].astype(np.uint8)), crowded[kept])


def _small_things(parents: Indices, sizes: Ids, fits: Doubles, things: Flags) -> Flags:
    """Return the nodes strictly within things that are small on them, and that masks of the photos still fit.

    A plate that shares masks with the table costs the table little of its fit: weighed by weight the two stay one.
    So nodes within are weighed by a power of their size, which favours small ones, and those that are small and fit
    are taken. Where they make up half of a thing or more, it is only cut in pieces, and none is taken.
    """
    thing = _above(parents, things)
    best = best_nodes(parents, np.where(thing >= 0, sizes**SMALL_SIZE_POWER * np.sqrt(fits), NONE))
    small = best & (fits >= MIN_SMALL_FIT) & (sizes <= MAX_SMALL_SHARE * sizes[thing])
    taken = np.bincount(thing[small], sizes[small], minlength=len(parents))
    return np.asarray(small & (taken <= sizes / 2)[thing])


def _within(parents: WholeNumbers, nodes: OtherIndices) -> OtherIndices:
    """Return the forest of some nodes alone: for each the number of the lowest of them above it, -1 for none."""
    among = np.zeros(len(parents), bool)
    among[nodes] = True
    number = np.append(np.cumsum(among) - 1, NONE)  # -1 stays -1
    return np.asarray(number[_above(parents, among)[nodes]])


def best_nodes(parents: WholeNumbers, worth: Doubles) -> Flags:
    """Return the set of nodes, none above another, of the largest sum of worth; negative worth is never chosen.

    Of sets of equal sums it is the one of larger nodes. Linear: children come before their parents.
    """
    below = [0.0] * len(parents)
    own = np.zeros(len(parents), bool)
    for node, (parent, value) in enumerate(zip(parents.tolist(), worth.tolist(), strict=True)):
        own[node] = value >= max(below[node], 0.0)
        if parent >= 0:
            below[parent] += max(value, below[node])
    return np.asarray(own & (_above(parents, own) < 0))


def _above(parents: WholeNumbers, nodes: Flags) -> Indices:
    """Return for each node the lowest of `nodes` above it, -1 for none."""
    return np.asarray(np.append(owner_nodes(parents, nodes), NONE)[parents])


def pairs_above(parents: WholeNumbers) -> tuple[OtherIndices, OtherIndices]:
    """Return all pairs of a node and one that is above it, or itself."""
    below = above = np.arange(len(parents))
    lower, upper = [below], [above]
    while len(below):
        above = parents[above].astype(np.int64)
        below, above = below[above >= 0], above[above >= 0]
        lower.append(below)
        upper.append(above)
    return np.concatenate(lower), np.concatenate(upper)


def _parts(parents: Indices, worth: Doubles, things: Flags) -> Flags:
    """Return the best nodes strictly within things, where a thing has two or more."""
    thing = _above(parents, things)
    best = best_nodes(parents, np.where(thing >= 0, worth, NONE))
    several = np.bincount(thing[best], minlength=len(parents)) > 1
    return np.asarray(best & several[thing])


def holding(parents: WholeNumbers, nodes: OtherIndices) -> Flags:
    """Mark nodes that are among some or above one of them; -1 is none."""
    marked = np.zeros(len(parents), bool)
    at = np.unique(nodes)
    while len(at := at[at >= 0]):
        at = at[~marked[at]]
        marked[at] = True
        at = np.unique(parents[at])
    return marked


def _several_branches(parents: Indices, things: Flags) -> Flags:
    """Return the nodes with things below two or more of their children."""
    holds = things.tolist()
    branches = [0] * len(holds)
    for node, parent in enumerate(parents.tolist()):
        holds[node] |= branches[node] > 0
        if parent >= 0 and holds[node]:
            branches[parent] += 1
    return np.array(branches) > 1


def _tree_of(forest: Forest, node_of: RowIds, nodes: Indices, levels: ByteValues) -> Tree:
    """Return the tree of the chosen nodes alone, in their order."""
    among = np.zeros(len(forest.parents), bool)
    among[nodes] = True
    number = np.append(np.cumsum(among) - 1, NONE)
    lowest = number[np.append(owner_nodes(forest.parents, among), NONE)[node_of]]
    parents = _within(forest.parents, nodes)
    return Tree(lowest.astype(np.int32), parents.astype(np.int32), levels, forest.fits[nodes])


def _with_rests(tree: Tree, crowded: Flags) -> Tree:
    """Make each crowded node a group; a new thing before it gets the rows that are in none of its things."""
    number = np.append(np.arange(len(crowded)) + np.cumsum(crowded), NONE)  # -1 stays -1
    rest = number - np.append(crowded, False)
    new, count = number[:-1], len(crowded) + int(np.count_nonzero(crowded))
    parents, levels, sure = np.full(count, NONE, np.int32), np.full(count, THING, np.uint8), np.zeros(count, np.float32)
    parents[new] = np.where(tree.levels == PART, rest[tree.parents], number[tree.parents])
    parents[new[crowded] - 1] = new[crowded]
    levels[new] = tree.levels
    sure[new] = sure[rest[:-1]] = tree.sure
    return Tree(rest[tree.node_of].astype(np.int32), parents, levels, sure)
