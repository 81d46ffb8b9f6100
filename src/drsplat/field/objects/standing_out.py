"""Sets of pieces that stand out most from what is beside them: grown from one piece, then refined piece by piece.

*Relief* of a set is the share of its outline at which it stands in front of what is beside it; where it is behind
something else nobody knows how it goes on, and that counts for neither side. Borders within the set do not count.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Bool, Float64, Int64
from .borders import Borders

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
    them. back: its transpose. level: (n, n), symmetric, where depth goes on.
    """

    areas: Float64[np.ndarray, " n"]
    front: csr_array
    back: csr_array
    level: csr_array

    @classmethod
    def of(cls, found: Borders) -> "Outlines":
        """Return the outlines of pieces whose borders were found in photos."""
        shape = (len(found.areas),) * 2
        level = csr_array((found.levels.astype(np.float64), (found.front, found.back)), shape=shape)
        front = csr_array(((found.lengths - found.levels).astype(np.float64), (found.front, found.back)), shape=shape)
        return cls(found.areas.astype(np.float64), front, csr_array(front.T), csr_array(level + level.T))

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
        return relief(self.fronts, self.levels)

    @cached_property
    def largest(self) -> float:
        """Pixels that a set may have at most."""
        return MAX_AREA_SHARE * float(self.areas.sum())


def relief(front: Float64[np.ndarray, " *s"], level: Float64[np.ndarray, " *s"]) -> Float64[np.ndarray, " *s"]:
    """Return the relief of an outline, from its pixels in front and those where depth goes on; near 0 for a few."""
    return np.asarray(front / (front + level + RELIEF_PRIOR_PIXELS))


def goes_on(level: Float64[np.ndarray, " *s"], front: Float64[np.ndarray, " *s"]) -> Bool[np.ndarray, " *s"]:
    """Return whether borders hold a set together, from their pixels where depth goes on and where it jumps."""
    return np.asarray(level >= MIN_LEVEL_SHARE * (level + front))


class PieceSet:
    """A set of pieces that can be added to and taken from, with its outline and the borders within it.

    before, behind, beside: pixels of the border of each piece with the set where the piece is in front of the set,
    where it is behind the set, and where depth goes on.
    """

    def __init__(self, outlines: Outlines, members: Int64[np.ndarray, " k"]) -> None:
        self.outlines = outlines
        self.within = np.zeros(len(outlines.areas), bool)
        self.before, self.behind, self.beside = (np.zeros(len(self.within)) for _ in range(3))
        self.area = self.front = self.level = self.inner_front = self.inner_level = 0.0
        for piece in members.tolist():
            self.change(piece)

    @property
    def members(self) -> Int64[np.ndarray, " k"]:
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

    def changes(self, free: Bool[np.ndarray, " n"]) -> Int64[np.ndarray, " c"]:
        """Return the pieces that may be added or taken out: pieces of the set, and what depth goes on to from it.

        free: pieces that may be added. Of others those that are small in the set may (`MAX_SMALL_SHARE`): a bow on a
        doll is whole by itself, and hides some of the doll's outline. Nothing is added that makes the set too large.
        """
        pieces = np.flatnonzero(self.within | (self.beside > 0))
        areas, within = self.outlines.areas[pieces], self.within[pieces]
        together = self.area + areas
        fits = (free[pieces] | (areas <= MAX_SMALL_SHARE * together)) & (together <= self.outlines.largest)
        return pieces[within | fits]

    def reliefs(self, pieces: Int64[np.ndarray, " c"]) -> Float64[np.ndarray, " c"]:
        """Return the relief of the set once each piece alone is added to it, or taken out of it."""
        sign = self._signs(pieces)
        front = self.outlines.fronts[pieces] - self.behind[pieces] - self.before[pieces]
        level = self.outlines.levels[pieces] - 2 * self.beside[pieces]
        return relief(self.front + sign * front, self.level + sign * level)

    def holding(self, pieces: Int64[np.ndarray, " c"]) -> Bool[np.ndarray, " c"]:
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

    def _signs(self, pieces: Int64[np.ndarray, " c"]) -> Float64[np.ndarray, " c"]:
        return np.where(self.within[pieces], -1.0, 1.0)


def grown(outlines: Outlines, seed: int, free: Bool[np.ndarray, " n"]) -> Int64[np.ndarray, " k"]:
    """Return the set that stands out most of those that come about as pieces are added to a seed, best first.

    Each time the neighbour is added with which the set stands out most, also where that is less than before: a thing
    of many pieces stands out little until most of it is there. Along half of the borders within the returned set depth
    goes on (`MIN_LEVEL_SHARE`). free: see `PieceSet.changes`.
    """
    growing = PieceSet(outlines, np.array([seed]))
    order, best, length = [seed], growing.relief, 1
    while len(order) < MAX_PIECES:
        pieces = growing.changes(free)
        pieces = pieces[~growing.within[pieces]]
        if not len(pieces):
            break
        piece = int(pieces[growing.reliefs(pieces).argmax()])
        growing.change(piece)
        order.append(piece)
        if growing.relief > best and growing.holds:
            best, length = growing.relief, len(order)
    return np.sort(np.array(order[:length]))


def refined(outlines: Outlines, members: Int64[np.ndarray, " k"], free: Bool[np.ndarray, " n"]) -> PieceSet:
    """Return the set once no single piece added or taken out lets it stand out more; every step is the best one.

    No step is taken after which depth does not go on along half of the borders within. free: see `PieceSet.changes`.
    """
    growing = PieceSet(outlines, members)
    for _ in range(4 * MAX_PIECES):
        pieces = growing.changes(free)
        if np.count_nonzero(growing.within) == 1:
            pieces = pieces[~growing.within[pieces]]
        pieces = pieces[growing.holding(pieces)]
        reliefs = growing.reliefs(pieces)
        if not len(pieces) or reliefs.max() <= growing.relief + RELIEF_TOLERANCE:
            break
        growing.change(int(pieces[reliefs.argmax()]))
    return growing
