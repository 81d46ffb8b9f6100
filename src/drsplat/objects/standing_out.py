"""Sets of pieces that stand out most from what is beside them: grown from one piece, then refined piece by piece.

*Relief* of a set is the share of its outline at which it stands in front of what is beside it; where it is behind
something else nobody knows how it goes on, and that counts for neither side. Borders within the set do not count.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import csr_array

from .borders import Borders

GOES_ON = 0.5  # least share of the borders within a set along which depth goes on
FEW = 30  # pixels of outline that a relief is held against
MAX_PIECES = 100  # of a thing
SMALL = 0.1  # share of a set: what is no piece of it may lie on it up to this size
SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class Outlines:
    """Borders between all pieces, in pixels over all photos; whole numbers, so that sums are exact.

    front: (n, n), where the piece of a row is in front of that of a column, depth jumping between them. back: its
    transpose. level: (n, n), symmetric, where depth goes on.
    """

    front: csr_array
    back: csr_array
    level: csr_array

    @classmethod
    def of(cls, found: Borders) -> "Outlines":
        shape = (len(found.areas),) * 2
        level = csr_array((found.levels.astype(np.float64), (found.front, found.back)), shape=shape)
        front = csr_array(((found.lengths - found.levels).astype(np.float64), (found.front, found.back)), shape=shape)
        return cls(front, csr_array(front.T), csr_array(level + level.T))

    @cached_property
    def fronts(self) -> Float64[np.ndarray, " n"]:
        """Pixels of its outline where each piece is in front."""
        return np.asarray(self.front.sum(axis=1)).ravel()

    @cached_property
    def levels(self) -> Float64[np.ndarray, " n"]:
        """Pixels of its outline where depth goes on, of each piece."""
        return np.asarray(self.level.sum(axis=1)).ravel()

    @cached_property
    def reliefs(self) -> Float64[np.ndarray, " n"]:
        """Relief of each piece alone."""
        return np.asarray(relief(self.fronts, self.levels))

    def relief(self, members: Int64[np.ndarray, " k"]) -> float:
        """Return the relief of a set of pieces."""
        front = self.fronts[members].sum() - self.front[members][:, members].sum()
        level = self.levels[members].sum() - self.level[members][:, members].sum()
        return float(relief(np.array(front), np.array(level)))

    def holds(self, members: Int64[np.ndarray, " k"]) -> bool:
        """Return whether depth goes on along enough of the borders between the pieces of a set."""
        level, front = self.level[members][:, members].sum() / 2, self.front[members][:, members].sum()
        return bool(goes_on(np.array(level), np.array(front)))


def relief(front: Float64[np.ndarray, "*s"], level: Float64[np.ndarray, "*s"]) -> Float64[np.ndarray, "*s"]:
    """Share of an outline, from its pixels in front and those where depth goes on; near 0 for a few pixels."""
    return np.asarray(front / (front + level + FEW))


def goes_on(level: Float64[np.ndarray, "*s"], front: Float64[np.ndarray, "*s"]) -> Bool[np.ndarray, "*s"]:
    """Return whether borders hold a set together, from their pixels where depth goes on and where it jumps."""
    return np.asarray(level >= GOES_ON * (level + front))


class _Growing:
    """A set of pieces, and of each piece what of its border is with the set."""

    def __init__(self, outlines: Outlines, members: Int64[np.ndarray, " k"]) -> None:
        self.outlines = outlines
        self.within = np.zeros(len(outlines.fronts), bool)
        self.before, self.behind, self.beside = (np.zeros(len(self.within)) for _ in range(3))
        self.front = self.level = self.inner_front = self.inner_level = 0.0
        for piece in members.tolist():
            self.change(piece)

    @property
    def members(self) -> Int64[np.ndarray, " k"]:
        return np.flatnonzero(self.within)

    @property
    def relief(self) -> float:
        return float(relief(np.array(self.front), np.array(self.level)))

    @property
    def holds(self) -> bool:
        """True where depth goes on along enough of the borders within."""
        return bool(goes_on(np.array(self.inner_level), np.array(self.inner_front)))

    def reliefs(self) -> Float64[np.ndarray, " n"]:
        """Return the relief of the set once each piece alone is added to it, or taken out of it."""
        sign = self._signs
        front = self.front + sign * (self.outlines.fronts - self.behind - self.before)
        return relief(front, self.level + sign * (self.outlines.levels - 2 * self.beside))

    def holding(self) -> Bool[np.ndarray, " n"]:
        """Return for each of these sets whether depth goes on along enough of the borders within."""
        sign = self._signs
        return goes_on(self.inner_level + sign * self.beside, self.inner_front + sign * (self.before + self.behind))

    @property
    def _signs(self) -> Float64[np.ndarray, " n"]:
        return np.where(self.within, -1.0, 1.0)

    def change(self, piece: int) -> None:
        """Add a piece, or take it out."""
        sign = float(self._signs[piece])
        before, behind, beside = self.before[piece], self.behind[piece], self.beside[piece]
        self.front += sign * float(self.outlines.fronts[piece] - behind - before)
        self.level += sign * float(self.outlines.levels[piece] - 2 * beside)
        self.inner_front += sign * float(before + behind)
        self.inner_level += sign * float(beside)
        for sums, rows in (
            (self.before, self.outlines.front),
            (self.behind, self.outlines.back),
            (self.beside, self.outlines.level),
        ):
            part = slice(rows.indptr[piece], rows.indptr[piece + 1])
            sums[rows.indices[part]] += sign * rows.data[part]
        self.within[piece] ^= True


def grown(
    outlines: Outlines, seed: int, areas: Float64[np.ndarray, " n"], free: Bool[np.ndarray, " n"], most: float
) -> Int64[np.ndarray, " k"]:
    """Return the set that stands out most of those that come about as pieces are added to a seed, best first.

    Each time the neighbour is added with which the set stands out most, also where that is less than before: a thing
    of many pieces stands out little until most of it is there. Along half of the borders within the returned set depth
    goes on (`GOES_ON`). free: pieces that may be added. Of others those that are small in the set may (`SMALL`): a bow
    on a doll is whole by itself, and hides some of the doll's outline. most: area of a set.
    """
    growing = _Growing(outlines, np.array([seed]))
    order, size, best, length = [seed], areas[seed], growing.relief, 1
    while len(order) < MAX_PIECES:
        open_ = _fitting(areas, free, size, most) & ~growing.within & (growing.beside > 0)
        if not open_.any():
            break
        piece = int(np.where(open_, growing.reliefs(), -1).argmax())
        growing.change(piece)
        order.append(piece)
        size += areas[piece]
        if growing.relief > best and growing.holds:
            best, length = growing.relief, len(order)
    return np.sort(np.array(order[:length]))


def _fitting(
    areas: Float64[np.ndarray, " n"], free: Bool[np.ndarray, " n"], size: float, most: float
) -> Bool[np.ndarray, " n"]:
    """Return which pieces may be added to a set of some area."""
    return np.asarray((free | (areas <= SMALL * (size + areas))) & (size + areas <= most))


def refined(
    outlines: Outlines,
    members: Int64[np.ndarray, " k"],
    areas: Float64[np.ndarray, " n"],
    free: Bool[np.ndarray, " n"],
    most: float,
) -> Int64[np.ndarray, " c"]:
    """Return the set once no single piece added or taken out lets it stand out more; every step is the best one.

    Arguments are those of `grown`. No step is taken after which depth does not go on along half of the borders within.
    """
    growing, size = _Growing(outlines, members), areas[members].sum()
    for _ in range(4 * MAX_PIECES):
        open_ = _fitting(areas, free, size, most) & (growing.beside > 0)
        open_ = (open_ & ~growing.within | growing.within & (np.count_nonzero(growing.within) > 1)) & growing.holding()
        reliefs = np.where(open_, growing.reliefs(), -1)
        piece = int(reliefs.argmax())
        if reliefs[piece] <= growing.relief + SLACK:
            break
        size += -areas[piece] if growing.within[piece] else areas[piece]
        growing.change(piece)
    return growing.members
