"""A scene over time: Gaussians whose rows move, and stay who they are."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from ..arrays import Float32, Float64
from ..errors import InputError
from .gaussians import Gaussians

Span = tuple[float | int, float | int]  # of time, its ends included
ROUNDING = 1e-9  # of the span: what times written with fewer digits may be off at its ends


@runtime_checkable
class Motion(Protocol):
    """Where rows are: at a time of the span, all of them, in their order."""

    def at(self, time: float) -> Gaussians: ...


@dataclass(frozen=True, eq=False)
class Moving:
    """N Gaussians that move.

    canonical: the rows as a field knows them: their order and count, and the fingerprint, are those of every time.
    times: at which the scene is known, increasing, in the unit of the views' times; the first and the last one are the
    span. motion: where the rows are in between.

    Raises: InputError: times that are not finite or do not increase, or fewer than two.
    """

    canonical: Gaussians
    times: Float64[np.ndarray, " t"]
    motion: Motion

    def __post_init__(self) -> None:
        check_times(self.times)

    def __repr__(self) -> str:
        low, high = self.span
        return f"Moving({self.canonical!r}, {len(self.times):,} times from {low:g} to {high:g})"

    def __len__(self) -> int:
        """Gaussians, as of `canonical`."""
        return len(self.canonical)

    @property
    def span(self) -> tuple[float, float]:
        return float(self.times[0]), float(self.times[-1])

    def at(self, time: float | int) -> Gaussians:
        """The same rows where they are at a time; they have the fingerprint of `canonical`, whose rows they are.

        Raises: InputError: a time outside of the span: rows are not guessed. FormatError: a damaged frame.
        """
        moved = replace(self.motion.at(self.inside(time)))  # the frame itself keeps its own fingerprint
        moved.__dict__["fingerprint"] = self.canonical.fingerprint
        return moved

    def inside(self, time: float | int) -> float:
        """A time of the span. Raises: InputError: it is outside."""
        low, high = self.span
        if not low - ROUNDING * (high - low) <= time <= high + ROUNDING * (high - low):
            raise InputError(
                f"time {time:g} is outside of this scene's span, {low:g} to {high:g}: give times in its unit, or the "
                "scene other times (`drsplat motion --times FIRST LAST`)"
            )
        return min(max(float(time), low), high)

    def nearest(self, time: float | int) -> float:
        """The time of the span that is nearest to any."""
        return float(np.clip(time, *self.span))


def still(scene: Gaussians | Moving) -> Gaussians:
    """A scene that does not move. Raises: InputError: this one does."""
    if isinstance(scene, Moving):
        raise InputError("this scene moves, and a list of edits is of one that stands still: edit a PLY of one time")
    return scene


def canonical_of(scene: Gaussians | Moving) -> Gaussians:
    """The rows that a field is of."""
    return scene.canonical if isinstance(scene, Moving) else scene


@dataclass(frozen=True, eq=False)
class Frames:
    """Motion by key frames, of which two are held: positions, sizes, opacities and colours on straight lines between
    them, rotations the shorter way round, normalised.

    times: of the frames. read: a frame by its number; all have the same number of rows, and of harmonics.
    """

    times: Float64[np.ndarray, " t"]
    read: Callable[[int], Gaussians]
    _held: Callable[[int], Gaussians] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_held", lru_cache(maxsize=2)(self.read))

    def at(self, time: float) -> Gaussians:
        after = int(np.searchsorted(self.times, time))
        if self.times[after] == time:
            return self._held(after)
        begin, end = float(self.times[after - 1]), float(self.times[after])
        return between(self._held(after - 1), self._held(after), (time - begin) / (end - begin))


def between(one: Gaussians, other: Gaussians, share: float) -> Gaussians:
    """Part of the way from one to another state of the same rows; what is equal in both stays as it is, to the bit.

    share: from 0 to 1. Both counted from one origin.
    """
    return replace(
        one,
        means=_straight(one.means, other.means, share),
        quats=_turned(one.quats, other.quats, share),
        scales=_straight(one.scales, other.scales, share),
        opacities=_straight(one.opacities, other.opacities, share),
        sh=_straight(one.sh, other.sh, share),
    )


def counted_from(gaussians: Gaussians, origin: Float64[np.ndarray, " 3"]) -> Gaussians:
    """The same Gaussians counted from another origin; themselves where it is theirs."""
    if np.array_equal(gaussians.origin, origin):
        return gaussians
    return replace(gaussians, means=(gaussians.positions - origin).astype(np.float32), origin=origin)


def check_times(times: Float64[np.ndarray, " t"]) -> None:
    """Raises: InputError: fewer than two, not finite, or not increasing."""
    if times.ndim != 1 or times.dtype != np.float64 or len(times) < 2:
        raise InputError(f"times: expected two or more float64 numbers, got {times.dtype} {times.shape}")
    if not np.isfinite(times).all() or not (times[1:] > times[:-1]).all():
        wrong = int(np.argmin(np.isfinite(times) & np.append(True, times[1:] > times[:-1])))
        raise InputError(f"times: expected finite numbers that increase; number {wrong} is {times[wrong]:g}")


def _straight(
    one: Float32[np.ndarray, "*n"], other: Float32[np.ndarray, "*n"], share: float
) -> Float32[np.ndarray, "*n"]:
    wide = one.astype(np.float64)
    return np.asarray(wide + (other - wide) * share, np.float32)


def _turned(
    one: Float32[np.ndarray, "n 4"], other: Float32[np.ndarray, "n 4"], share: float
) -> Float32[np.ndarray, "n 4"]:
    wide, target = one.astype(np.float64), other.astype(np.float64)
    target = np.where((wide * target).sum(1, keepdims=True) < 0, -target, target)  # q and -q turn alike
    way = target - wide
    mixed = wide + way * share
    mixed /= np.linalg.norm(mixed, axis=1, keepdims=True)
    return np.where(way.any(1, keepdims=True), mixed.astype(np.float32), one)
