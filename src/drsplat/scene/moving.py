"""Scenes over time: Gaussians that move and keep their row numbers."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from ..base.arrays import Array, Doubles, Float32, Vector3
from ..errors import InputError
from .gaussians import Gaussians

Span = tuple[float | int, float | int]  # of time, its ends included
ROUNDING_SHARE = 1e-9  # of the span: error allowed at its ends, for times written with fewer digits


@runtime_checkable
class Motion(Protocol):
    """Positions of rows over time: at any time of the span, all rows in their order."""

    def at(self, time: float) -> Gaussians: ...


@dataclass(frozen=True, eq=False)
class Moving:
    """N Gaussians that move.

    canonical: the rows as a field has them; their order, count and fingerprint are those of every time. times: at which
    the scene is sampled, increasing, in the unit of the views' times; the first and the last are the span. motion:
    gives the rows in between.

    Raises: InputError: times that are not finite or do not increase, or fewer than two.
    """

    canonical: Gaussians
    times: Doubles
    motion: Motion

    def __post_init__(self) -> None:
        times = self.times
        if times.ndim != 1 or times.dtype != np.float64 or len(times) < 2:
            raise InputError(f"times: expected two or more float64 numbers, got {times.dtype} {times.shape}")
        if not np.isfinite(times).all() or not (times[1:] > times[:-1]).all():
            wrong = int(np.argmin(np.isfinite(times) & np.append(True, times[1:] > times[:-1])))
            raise InputError(f"times: expected finite numbers that increase; number {wrong} is {times[wrong]:g}")

    def __repr__(self) -> str:
        low, high = self.span
        return f"Moving({self.canonical!r}, {len(self.times):,} times from {low:g} to {high:g})"

    def __len__(self) -> int:
        """Return the number of Gaussians."""
        return len(self.canonical)

    @property
    def span(self) -> tuple[float, float]:
        return float(self.times[0]), float(self.times[-1])

    def at(self, time: float | int) -> Gaussians:
        """Return the rows as they are at a time, with the fingerprint of `canonical`.

        Raises: InputError: a time outside of the span: rows are not guessed. FormatError: a damaged frame.
        """
        moved = replace(self.motion.at(self.inside(time)))  # the frame itself keeps its own fingerprint
        moved.__dict__["fingerprint"] = self.canonical.fingerprint
        return moved

    def inside(self, time: float | int) -> float:
        """Return a time clipped to the span, after a check. Raises: InputError: it is outside by more than rounding."""
        low, high = self.span
        if not low - ROUNDING_SHARE * (high - low) <= time <= high + ROUNDING_SHARE * (high - low):
            raise InputError(
                f"time {time:g} is outside of this scene's span, {low:g} to {high:g}: give times in its unit, or the "
                "scene other times (`drsplat motion --times FIRST LAST`)"
            )
        return min(max(float(time), low), high)

    def nearest(self, time: float | int) -> float:
        """Return the time of the span nearest to any time."""
        return float(np.clip(time, *self.span))


def still(scene: Gaussians | Moving) -> Gaussians:
    """Return a scene that does not move. Raises: InputError: this one does."""
    if isinstance(scene, Moving):
        raise InputError("this scene moves, and a list of edits is of one that stands still: edit a PLY of one time")
    return scene


def canonical_of(scene: Gaussians | Moving) -> Gaussians:
    """Return the rows that fields of the scene refer to."""
    return scene.canonical if isinstance(scene, Moving) else scene


@dataclass(frozen=True, eq=False)
class Frames:
    """Motion by key frames, two of which are kept in memory.

    Positions, sizes, opacities and colours are interpolated linearly, rotations the shorter way round, normalised.
    times: of the frames. read: reads a frame by number; all have the same number of rows and harmonics.
    """

    times: Doubles
    read: Callable[[int], Gaussians]
    _cached: Callable[[int], Gaussians] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_cached", lru_cache(maxsize=2)(self.read))

    def at(self, time: float) -> Gaussians:
        after = int(np.searchsorted(self.times, time))
        if self.times[after] == time:
            return self._cached(after)
        begin, end = float(self.times[after - 1]), float(self.times[after])
        return between(self._cached(after - 1), self._cached(after), (time - begin) / (end - begin))


def between(one: Gaussians, other: Gaussians, share: float) -> Gaussians:
    """Interpolate between two states of the same rows; what is equal in both stays equal to the bit.

    share: from 0 to 1. Both states must be counted from one origin.
    """
    begin, target = one.quats.astype(np.float64), other.quats.astype(np.float64)
    target = np.where((begin * target).sum(1, keepdims=True) < 0, -target, target)  # q and -q turn alike
    way = target - begin
    mixed = begin + way * share
    mixed /= np.linalg.norm(mixed, axis=1, keepdims=True)
    return replace(
        one,
        means=_linear(one.means, other.means, share),
        quats=np.where(way.any(1, keepdims=True), mixed.astype(np.float32), one.quats),
        scales=_linear(one.scales, other.scales, share),
        opacities=_linear(one.opacities, other.opacities, share),
        sh=_linear(one.sh, other.sh, share),
    )


def counted_from(gaussians: Gaussians, origin: Vector3) -> Gaussians:
    """Return the Gaussians counted from another origin; the same object if it has that origin already."""
    if np.array_equal(gaussians.origin, origin):
        return gaussians
    return replace(gaussians, means=(gaussians.positions - origin).astype(np.float32), origin=origin)


def _linear(start: Float32[Array, "*n"], end: Float32[Array, "*n"], share: float) -> Float32[Array, "*n"]:
    wide = start.astype(np.float64)
    return np.asarray(wide + (end - wide) * share, np.float32)
