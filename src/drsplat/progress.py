"""Progress on the terminal, and what a run has cost."""

import sys
import time
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, TypeVar

from .terminal import plain

if TYPE_CHECKING:
    from rich.progress import Progress

T = TypeVar("T")
PATIENCE_S = 2.0
LINE_EVERY_S = 10.0


def track(items: Sequence[T], description: str, *, quiet: bool = False) -> Iterator[T]:
    """The items, with the progress of a `Meter`."""
    with Meter(description, len(items), quiet=quiet) as meter:
        for done, item in enumerate(items, 1):
            yield item
            meter.update(done, item if isinstance(item, str) else "")


class Meter:
    """Progress of one long job, with what it has to say: a bar on a terminal, else a line now and then.

    All on stderr; nothing where `quiet`, and nothing in the first two seconds.
    """

    def __init__(self, description: str, total: int, *, quiet: bool = False) -> None:
        self._description, self._total, self._quiet = description, total, quiet
        self._begin = self._told = time.monotonic()
        self._first: int | None = None
        self._bar: Progress | None = None

    def __enter__(self) -> "Meter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, done: int, text: str) -> None:
        """done: of `total`, also what was done in an earlier sitting."""
        if self._first is None:
            self._first, self._begin = done - 1, time.monotonic()
        elapsed = time.monotonic() - self._begin
        if self._quiet or elapsed < PATIENCE_S:
            return
        rate = f"{(done - self._first) / elapsed:.1f}"
        if sys.stderr.isatty():
            self._show(done, text, rate)
        elif time.monotonic() - self._told > LINE_EVERY_S:
            self._told = time.monotonic()
            left = elapsed / (done - self._first) * (self._total - done)
            parts = f"{done}/{self._total}", plain(text), f"{rate}/s", f"{_duration(left)} left"
            print(f"{self._description}: {', '.join(filter(None, parts))}", file=sys.stderr, flush=True)

    def _show(self, done: int, text: str, rate: str) -> None:
        if self._bar is None:
            self._bar = _job_bar()
            self._bar.add_task(self._description, total=self._total, rate=rate, text=text)
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], completed=done, rate=rate, text=plain(text))


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _job_bar() -> "Progress":
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[text]}"),
        TextColumn("{task.fields[rate]}/s"), TimeRemainingColumn(), console=Console(stderr=True), transient=True,
    )  # fmt: skip


class Stopwatch:
    """seconds: by the name of the stage, in order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now
