"""Scenes that are not in memory: Gaussians in parts, such as tiles on disk, read when their rows are asked for."""

from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from ..base.arrays import Doubles, Float64, Numbers, OtherIndices, Points, RowIds, Vector3, WholeNumbers
from .gaussians import Gaussians, Part

HELD_BYTES = 64 << 20  # of shapes, of the parts looked at last
SPARE = 1e-6  # of a distance to a box of float32 corners


@dataclass(frozen=True, eq=False)
class Parted:
    """N Gaussians in parts, whose rows follow each other. Several threads may read at once.

    starts: first row of each part, then N. low, high: boxes of the parts' centres, counted from `origin`. origin,
    fingerprint, near, antialiased: as of `Gaussians`. read: reads a part by its number; read_shapes: without colours.
    Held are the shapes of the parts looked at last, up to HELD_BYTES.
    """

    starts: OtherIndices
    low: Points
    high: Points
    origin: Vector3
    fingerprint: str
    near: float
    antialiased: bool
    read: Callable[[int], Gaussians]
    read_shapes: Callable[[int], Gaussians]
    _held: OrderedDict[int, Gaussians] = field(default_factory=OrderedDict, init=False, repr=False)
    _lock: Lock = field(default_factory=Lock, init=False, repr=False)

    def __repr__(self) -> str:
        return f"Parted({len(self):,} Gaussians in {len(self.starts) - 1:,} parts, {self.fingerprint})"

    def __len__(self) -> int:
        return int(self.starts[-1])

    def subset(self, index: RowIds) -> Gaussians:
        """Return the Gaussians at some rows, in that order, with their colours. Raises: as `read`."""
        return self._gathered(index, self.read)

    def shapes_of(self, index: RowIds) -> Gaussians:
        """Return the Gaussians at some rows, in that order, without colours. Raises: as `read_shapes`."""
        return self._gathered(index, self._shapes)

    def opacities_of(self, index: WholeNumbers) -> Numbers:
        """Return the opacities of some rows. Raises: as `read_shapes`."""
        values = np.empty(len(index), np.float32)
        for number, at, rows in self._places(index):
            values[at] = self._shapes(number).opacities[rows]
        return values

    def parts_near(self, point: Vector3 | None = None) -> Iterator[Part]:
        """Yield all parts, those nearer to a point of the world first; in their order where there is none."""
        count = len(self.starts) - 1
        away2 = np.zeros(count)
        if point is not None:
            at = point - self.origin
            with np.errstate(over="ignore"):  # further away than can be squared
                away2 = (np.maximum(np.maximum(self.low - at, at - self.high), 0) ** 2).sum(1) * (1 - SPARE)
        for number in np.argsort(away2, kind="stable").tolist():
            yield Part(int(self.starts[number]), float(away2[number]), self._shapes(number))

    def _gathered(self, index: RowIds, read: Callable[[int], Gaussians]) -> Gaussians:
        """Return rows, read part by part into arrays of their own."""
        count, most = len(index), 1
        means, scales = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        quats, opacities = np.empty((count, 4), np.float32), np.empty(count, np.float32)
        sh = np.zeros((count, most, 3), np.float32)
        for number, at, rows in self._places(index):
            part = read(number)
            means[at], quats[at], scales[at] = part.means[rows], part.quats[rows], part.scales[rows]
            opacities[at] = part.opacities[rows]
            if part.sh.shape[1] > sh.shape[1]:
                sh = np.pad(sh, ((0, 0), (0, part.sh.shape[1] - sh.shape[1]), (0, 0)))
            sh[at, : part.sh.shape[1]] = part.sh[rows]
        return Gaussians(means, quats, scales, opacities, sh, {}, self.origin, self.antialiased)

    def _places(self, index: RowIds) -> Iterator[tuple[int, WholeNumbers, WholeNumbers]]:
        """Yield each part that has some of the rows: its number, their places among the rows, and their rows in it."""
        part = np.searchsorted(self.starts, index, "right") - 1
        order = np.argsort(part, kind="stable")
        for at in np.split(order, np.flatnonzero(np.diff(part[order])) + 1) if len(order) else ():
            number = int(part[at[0]])
            yield number, at, index[at] - self.starts[number]

    def _shapes(self, number: int) -> Gaussians:
        with self._lock:
            held = self._held.get(number)
            if held is not None:
                self._held.move_to_end(number)
                return held
        shapes = self.read_shapes(number)
        with self._lock:
            self._held[number] = shapes
            while len(self._held) > 1 and sum(_bytes(part) for part in self._held.values()) > HELD_BYTES:
                self._held.popitem(last=False)
        return shapes


def _bytes(part: Gaussians) -> int:
    return sum(array.nbytes for array in (part.means, part.quats, part.scales, part.opacities))


AnyGaussians = Gaussians | Parted
"""A scene in memory, or in parts on disk, of which queries ask for rows."""


def coordinates(gaussians: AnyGaussians, axis: int, among: WholeNumbers | None = None) -> Doubles:
    """Return one coordinate of all centres, or of some ascending rows, counted from the scene's origin."""
    values = np.empty(len(gaussians) if among is None else len(among))
    for part in gaussians.parts_near():
        end = part.first + len(part.gaussians)
        if among is None:
            values[part.first : end] = part.gaussians.means[:, axis]
        else:
            begin, end = np.searchsorted(among, np.array([part.first, end], among.dtype))
            values[begin:end] = part.gaussians.means[among[begin:end] - part.first, axis]
    return values


def middle(
    gaussians: AnyGaussians,
    shares: tuple[float, float],
    among: WholeNumbers | None = None,
    origin: Vector3 | None = None,
) -> Float64[np.ndarray, "2 3"]:
    """Return two quantiles of the centres along each axis, one axis after another: 8 bytes for each row.

    among: ascending rows; None: all. origin: is added to the coordinates before; None: nothing.
    """
    found = np.empty((2, 3))
    for axis in range(3):
        values = coordinates(gaussians, axis, among)
        if origin is not None:
            values += origin[axis]
        found[:, axis] = np.quantile(values, shares, overwrite_input=True)
    return found
