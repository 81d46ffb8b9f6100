"""Which nodes of a forest of merges are parts, things and groups."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int32, UInt8

from ..field.objects import GROUP, PART, THING
from ..kernels import Forest

APART = 0.4  # distance of embeddings (1: unrelated) of regions that are never one thing
MOST = 0.5  # of all weight: what holds more is no group but the room
NONE = -1


class Chosen(NamedTuple):
    """node_of: per row the smallest node, -1 for none. sure: how well the masks of the photos fit a node."""

    node_of: Int32[np.ndarray, " r"]
    parents: Int32[np.ndarray, " t"]
    levels: UInt8[np.ndarray, " t"]
    sure: np.ndarray


def choose(forest: Forest, rows: int, smallest: int) -> Chosen:
    """The hierarchy of a forest over so many rows.

    Things are the disjoint nodes with the largest sum of weight times the root of fit; none merges regions whose
    embeddings are `APART`. Parts are the same choice within each thing. Groups are nodes above that hold several.
    """
    worth = forest.masses * np.sqrt(forest.fits.astype(np.float64))
    judged = forest.sizes >= smallest
    things = best_nodes(forest.parents, np.where(judged & (forest.spreads <= APART), worth, NONE))
    parts = _parts(forest.parents, np.where(judged, worth, NONE), things)
    groups = _groups(forest, things)
    return _compressed(forest, rows, {PART: parts, THING: things, GROUP: groups})


def best_nodes(parents: Int32[np.ndarray, " t"], worth: Float64[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
    """The set of nodes, none above another, of the largest sum of worth; nodes of negative worth are never chosen.

    Of equal sums the one of larger nodes. Linear: children come before their parents.
    """
    below = np.zeros(len(parents))
    own = np.zeros(len(parents), bool)
    for node, parent in enumerate(parents.tolist()):
        own[node] = worth[node] >= max(below[node], 0.0)
        if parent >= 0:
            below[parent] += worth[node] if own[node] else below[node]
    return np.asarray(own & ~_below(parents, own))


def _below(parents: Int32[np.ndarray, " t"], nodes: Bool[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
    """Those with one of `nodes` above them."""
    below = np.zeros(len(parents), bool)
    for node in range(len(parents) - 1, -1, -1):
        parent = parents[node]
        if parent >= 0:
            below[node] = below[parent] or nodes[parent]
    return below


def _parts(
    parents: Int32[np.ndarray, " t"], worth: Float64[np.ndarray, " t"], things: Bool[np.ndarray, " t"]
) -> Bool[np.ndarray, " t"]:
    """The best nodes strictly within things, where a thing has two or more."""
    within = _below(parents, things)
    found = best_nodes(parents, np.where(within, worth, NONE))
    owner = _owners(parents, things)
    several = np.bincount(owner[found], minlength=len(parents)) > 1
    return np.asarray(found & several[owner])


def _owners(parents: Int32[np.ndarray, " t"], nodes: Bool[np.ndarray, " t"]) -> np.ndarray:
    """For each node itself or the lowest of `nodes` above it, -1 for none."""
    owner = np.full(len(parents), -1)
    for node in range(len(parents) - 1, -1, -1):
        parent = parents[node]
        owner[node] = node if nodes[node] else owner[parent] if parent >= 0 else -1
    return owner


def _groups(forest: Forest, things: Bool[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
    """Nodes above things, of two or more branches that hold some, but for what is most of the scene."""
    holds = things.copy()
    branches = np.zeros(len(things), int)
    for node, parent in enumerate(forest.parents.tolist()):
        holds[node] |= branches[node] > 0
        if parent >= 0 and holds[node]:
            branches[parent] += 1
    total = float(forest.masses[forest.parents < 0].sum(dtype=np.float64))
    return np.asarray((branches > 1) & (forest.masses <= MOST * total))


def _compressed(forest: Forest, rows: int, chosen: dict[int, Bool[np.ndarray, " t"]]) -> Chosen:
    """The chosen nodes alone, in their order."""
    kept = np.logical_or.reduce(list(chosen.values()))
    nodes = np.flatnonzero(kept)
    number = np.append(np.cumsum(kept) - 1, -1)  # -1 stays -1
    owner = _owners(forest.parents, kept)
    above = forest.parents[nodes]
    parents = np.where(above >= 0, number[owner[above]], -1).astype(np.int32)
    levels = np.zeros(len(nodes), np.uint8)
    for level, of_level in chosen.items():
        levels[of_level[nodes]] = level
    return Chosen(number[owner[:rows]].astype(np.int32), parents, levels, forest.fits[nodes])
