"""Outlines of pieces, neighbour by neighbour: where a piece is in front, where depth goes on, where it is behind."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int64

from .borders import Borders

FEW = 30  # pixels of border that a relief is held against
SHORT = 20  # pixels: shorter outlines count as that
MOST = 0.5  # of all pixels: what has more is the room


class Outline(NamedTuple):
    """Pixels of the border of a node with others: where it is in front, where depth goes on, and all."""

    front: float
    level: float
    length: float

    @property
    def relief(self) -> float:
        """Share of its border where a node stands in front of what is beside it; behind counts for neither."""
        return self.front / (self.front + self.level + FEW)


class Side(NamedTuple):
    """Pixels of the border of a node with a neighbour: where it is in front, level with it, behind."""

    front: int = 0
    level: int = 0
    behind: int = 0


def sides_of(found: Borders, numbers: Int64[np.ndarray, " n"], tolerance: int) -> dict[int, dict[int, Side]]:
    """Return by node and neighbour the border between them, seen from the node. numbers: the node of each piece."""
    sides: dict[int, dict[int, Side]] = {}
    fronts, backs = numbers[found.front].tolist(), numbers[found.back].tolist()
    levels = found.counts[:, tolerance].tolist()
    for front, back, level, length in zip(fronts, backs, levels, found.counts[:, -1].tolist(), strict=True):
        if front != back:
            jumps = length - level
            _add(sides.setdefault(front, {}), back, Side(jumps, level, 0))
            _add(sides.setdefault(back, {}), front, Side(0, level, jumps))
    return sides


def _add(sides: dict[int, Side], node: int, more: Side) -> None:
    sides[node] = Side(*map(sum, zip(sides.get(node, Side()), more, strict=True)))


def united(sides: dict[int, dict[int, Side]], one: int, other: int, new: int) -> dict[int, Side]:
    """Return the sides of two nodes as those of a new one, which their neighbours know from now on instead."""
    new_sides: dict[int, Side] = {}
    for old in (one, other):
        for beside, side in sides.pop(old).items():
            if beside in (one, other):
                continue
            _add(new_sides, beside, side)
            _add(sides[beside], new, sides[beside].pop(old))
    return new_sides


def outline_of(sides: dict[int, Side]) -> Outline:
    """Return the outline of the node that has these sides."""
    front, level, behind = map(sum, zip(*sides.values(), strict=True)) if sides else (0, 0, 0)
    return Outline(front, level, front + level + behind)
