"""Progress on the terminal, and the time of each stage of a run."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TypeVar

from .system import peak_memory_bytes
from .terminal import plain

if TYPE_CHECKING:
    from rich.progress import Progress

T = TypeVar("T")
PATIENCE_S = 2.0
LINE_EVERY_S = 10.0
MARK_EVERY_S, MAX_MARKS = 1.0, 600
BAR_COLUMNS = 10

Follower = Callable[[str, int, int, str], None]
"""Called with a meter's description, the number of finished items, their total, and a text."""
_FOLLOWER: ContextVar[Follower | None] = ContextVar("follower", default=None)


@contextmanager
def followed(follower: Follower) -> Iterator[None]:
    """Report all progress in the block to `follower` instead of the terminal."""
    before = _FOLLOWER.set(follower)
    try:
        yield
    finally:
        _FOLLOWER.reset(before)


def track(items: Sequence[T], description: str, *, quiet: bool = False) -> Iterator[T]:
    """Yield the items, with the progress of a `Meter`."""
    with Meter(description, len(items), quiet=quiet) as meter:
        for done, item in enumerate(items, 1):
            yield item
            meter.update(done, item if isinstance(item, str) else "")


class Meter:
    """Progress of one long job with a text: a bar on a terminal, else a line now and then.

    All on stderr; nothing where `quiet`, and nothing in the first two seconds.
    """

    def __init__(self, description: str, total: int, *, quiet: bool = False) -> None:
        self._description, self._total, self._quiet = description, total, quiet
        self._begin = self._last_line = time.monotonic()
        self._elapsed = 0.0
        self._marks: list[tuple[int, float]] = []  # items and seconds since the first
        self._bar: Progress | None = None

    def __enter__(self) -> "Meter":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, done: int, text: str) -> None:
        """Show or report progress. done: finished of `total`, those of an earlier run included."""
        follower = _FOLLOWER.get()
        if follower is None:
            self.draw(done, text)
        else:
            follower(self._description, done, self._total, text)

    def draw(self, done: int, text: str) -> None:
        """Show progress on the terminal, also while a follower is set."""
        left, per_item = self.left(done)
        if self._quiet or self._elapsed < PATIENCE_S:
            return
        facts = f"{done}/{self._total}", f"{1 / max(per_item, 1e-9):.1f}/s", f"{duration(left)} left"
        if self._bar is not None or sys.stderr.isatty():  # which the bar replaces, by what says it is no terminal
            # draw the bar and a line beside it, which is cut at its end where the terminal is narrow
            if self._bar is None:
                self._bar = _job_bar()
                self._bar.add_task(self._description, total=self._total, line="")
            room = self._bar.console.width - len(self._description) - BAR_COLUMNS - 3
            self._bar.update(
                self._bar.task_ids[0],
                completed=done,
                line="  ".join(filter(None, (*facts, plain(text))))[: max(room, 0)],
            )
            self._bar.start()  # which does nothing the second time
        elif time.monotonic() - self._last_line > LINE_EVERY_S:
            self._last_line = time.monotonic()
            parts = facts[0], plain(text), *facts[1:]
            print(f"{self._description}: {', '.join(filter(None, parts))}", file=sys.stderr, flush=True)

    def left(self, done: int) -> tuple[float, float]:
        """Return the seconds that are left, and those of an item of late."""
        if not self._marks:
            self._begin = time.monotonic()
        self._elapsed = time.monotonic() - self._begin
        now = done, self._elapsed
        if not self._marks or now[1] > self._marks[-1][1] + MARK_EVERY_S:
            self._marks.append(now)
        if len(self._marks) > MAX_MARKS:
            del self._marks[1::2]
        return seconds_left([*self._marks, now], self._total)


def seconds_left(marks: Sequence[tuple[int, float]], total: int) -> tuple[float, float]:
    """Return the time that is left, and that of an item of late.

    Items that become slower, as iterations of training do with the number of Gaussians, go on to: by as much as from
    the first half of what is done to the second, but at most to twice as slow.

    marks: numbers of finished items and the seconds since the first, ascending.
    """
    (first, _), (done, now) = marks[0], marks[-1]
    middle, then = min(marks, key=lambda mark: abs(2 * mark[0] - first - done))
    if not first < middle < done:
        middle, then = first - 1, 0.0
    late = (now - then) / max(done - middle, 1)
    early = then / (middle - first) if middle > first else late
    rest = total - done
    later = late + max(late - early, 0.0) * (0.5 + rest / max(done - first, 1))
    return rest * min(later, 2 * late), late


def duration(seconds: float) -> str:
    """Return a length of time in the unit that keeps it below three digits, up to hours."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"


def _job_bar() -> "Progress":
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}"), BarColumn(BAR_COLUMNS), TextColumn("{task.fields[line]}", markup=False),
        console=Console(stderr=True), transient=True,
    )  # fmt: skip


class Stopwatch:
    """Timer of consecutive stages. seconds: by the name of the stage, in order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now

    def measures(self) -> dict[str, Any]:
        """Return the time of all stages, of each, and the peak of the memory, as the answers of verbs have them."""
        return {
            "seconds": sum(self.seconds.values()),
            "stage_seconds": self.seconds,
            "peak_memory_bytes": peak_memory_bytes(),
        }
