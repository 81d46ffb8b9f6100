"""Work in parts: arrays for each item, made in this process or wherever a `Work` has them made, in the items' order."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from .arrays import Arrays, ArraysByName

T = TypeVar("T")
Part = Callable[[T, int], Arrays]
"""(item, threads) -> arrays, which do not depend on the threads."""


@runtime_checkable
class Track(Protocol):
    """Function that yields the items of a long job, in order, and shows its progress, such as `progress.track`."""

    def __call__(self, items: Sequence[T], description: str, /) -> Iterable[T]: ...


class _Untracked:
    """Track that shows nothing; as a default, `help` shows it by its name."""

    def __call__(self, items: Sequence[T], description: str, /) -> Iterable[T]:
        """Return the items."""
        return items

    def __repr__(self) -> str:
        return "untracked"


untracked = _Untracked()


@runtime_checkable
class Held(Protocol):
    """Arrays by name, in memory or in a file."""

    @property
    def arrays(self) -> ArraysByName: ...


@dataclass(frozen=True, eq=False)
class InMemory:
    """`Held` in this process."""

    arrays: ArraysByName


@runtime_checkable
class Work(Protocol):
    """Strategy of doing many alike things. The result never depends on the strategy. threads: of each part."""

    @property
    def threads(self) -> int: ...
    def hold(self, arrays: ArraysByName) -> Held:
        """Keep arrays where every part can have them."""

    def __call__(self, part: Part[T], items: Sequence[T], doing: str) -> list[Held]:
        """Return what `part` makes of each item, in their order. Both can be pickled. doing: a text for people."""


@dataclass(frozen=True)
class Here:
    """`Work` of this process. track: shows progress."""

    threads: int = 0
    track: Track = untracked

    def hold(self, arrays: ArraysByName) -> Held:
        return InMemory(arrays)

    def __call__(self, part: Part[T], items: Sequence[T], doing: str) -> list[Held]:
        return [InMemory(part(item, self.threads)) for item in self.track(items, doing)]


HERE = Here()
