"""By how many cells of a plane good ones are cloned into a hole: most of it closed at once, the seam as fits best."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve

from ...base.arrays import Bool, Float64, Int64

MEDIAN_WINDOW_CELLS = 21  # side of the window whose median colour a plane has in its middle
MIN_OUTLIER_DIFFERENCE = 0.12  # from that colour, of 1
OUTLIER_MEDIANS = 1.5  # in median differences: an outlier exceeds both
MIN_CLOSED_OF_BEST_SHARE = 0.9  # of the cells that the best shift closes: among such shifts the seam decides
MAX_SEAM_SHIFTS = 100  # whose seams are compared
SEAM_CELLS = 2  # around the missing ones
Cells = Bool[np.ndarray, "h w"]
Colors = Float64[np.ndarray, "h w 3"]
Shifts = Int64[np.ndarray, "s 2"]


@dataclass(frozen=True, eq=False)
class Surface:
    """The cells of a plane: their colours, and whether each is known, which it is outside of holes."""

    colors: Colors
    known: Cells

    def holds(self, colors: Float64[np.ndarray, "m 3"], cells: Shifts) -> Bool[np.ndarray, " m"]:
        """Return which Gaussians, in some cells, are of the surface: not cutlery, crumbs, whatever lies on it.

        Neither they nor what is drawn in their cells stand out from the colour around.
        """
        if not self.known.any():
            return np.ones(len(colors), bool)
        drawn = np.where(self.known[..., None], self.colors, np.median(self.colors[self.known], axis=0))
        middle = ndimage.median_filter(drawn, (MEDIAN_WINDOW_CELLS, MEDIAN_WINDOW_CELLS, 1))
        off = np.abs(drawn - middle).max(axis=2)
        plain = ~ndimage.binary_dilation(self.known & (off > _limit(off[self.known])))[cells[:, 0], cells[:, 1]]
        off = np.abs(colors - middle[cells[:, 0], cells[:, 1]]).max(axis=1)
        return np.asarray(plain & (off <= _limit(off)))

    def seam(self, missing: Cells, shift: Int64[np.ndarray, " 2"]) -> float:
        """Return how far the colours that a shift brings are from those around a hole; infinite where few are known."""
        ring = np.argwhere(ndimage.binary_dilation(missing, iterations=SEAM_CELLS) & ~missing & self.known)
        ring, there = _within(ring, shift, missing.shape)
        good = self.known[there[:, 0], there[:, 1]]
        if 2 * np.count_nonzero(good) < max(1, len(ring)):
            return np.inf
        ring, there = ring[good], there[good]
        return float(np.abs(self.colors[ring[:, 0], ring[:, 1]] - self.colors[there[:, 0], there[:, 1]]).mean())

    def closed(self, cells: Cells, shift: tuple[int, int]) -> "Surface":
        """Return the surface with colours cloned into some cells."""
        at, colors = np.argwhere(cells), self.colors.copy()
        there = at + shift
        colors[at[:, 0], at[:, 1]] = self.colors[there[:, 0], there[:, 1]]
        return Surface(colors, self.known | cells)


def _limit(off: Float64[np.ndarray, " n"]) -> float:
    return max(MIN_OUTLIER_DIFFERENCE, OUTLIER_MEDIANS * float(np.median(off)))


def best_shift(missing: Cells, good: Cells, surface: Surface | None) -> tuple[tuple[int, int], Cells]:
    """Return by how many cells a good one is away from most of what is missing, and the cells that this closes.

    Of shifts that close nearly as much, the one with the best seam; without a surface the nearest of equals.
    """
    counts = np.round(fftconvolve(good.astype(float), missing[::-1, ::-1].astype(float))).astype(int)
    rows, columns = (np.arange(length) - (side - 1) for length, side in zip(counts.shape, missing.shape, strict=True))
    lengths = np.hypot(rows[:, None], columns[None])
    order = np.lexsort((lengths.ravel(), -counts.ravel()))
    if surface is not None:
        nearly = order[: np.count_nonzero(counts >= max(1.0, MIN_CLOSED_OF_BEST_SHARE * counts.max()))]
        order = nearly[:: -(-len(nearly) // MAX_SEAM_SHIFTS)] if len(nearly) else order[:1]  # closes nothing
    down, across = np.unravel_index(order, counts.shape)
    shifts = np.stack([rows[down], columns[across]], axis=1)
    best = 0 if surface is None else int(np.argmin([surface.seam(missing, shift) for shift in shifts]))
    at, there = _within(np.argwhere(missing), shifts[best], missing.shape)
    closed = np.zeros_like(missing)
    closed[at[:, 0], at[:, 1]] = good[there[:, 0], there[:, 1]]
    return (int(shifts[best][0]), int(shifts[best][1])), closed


def _within(
    cells: Shifts, shift: Int64[np.ndarray, " 2"] | tuple[int, int], shape: tuple[int, ...]
) -> tuple[Int64[np.ndarray, "k 2"], Int64[np.ndarray, "k 2"]]:
    """Return the cells whose shifted ones are on the grid, and these."""
    there = cells + shift
    inside = ((there >= 0) & (there < np.array(shape))).all(axis=1)
    return cells[inside], there[inside]
