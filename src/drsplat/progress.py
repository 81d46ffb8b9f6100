"""Progress on the terminal, and what a run has cost."""

import resource
import sys
import time
from collections.abc import Iterator, Sequence
from typing import TypeVar

T = TypeVar("T")
PATIENCE_S = 2.0


def track(items: Sequence[T], description: str, *, quiet: bool = False) -> Iterator[T]:
    """The items, with a bar on stderr that has count, rate and time to go.

    Nothing is shown where stderr is no terminal, where `quiet`, and in the first two seconds.
    """
    if quiet or not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}/s"),
        TimeRemainingColumn(),
    )
    progress, start = (
        Progress(*columns, console=Console(stderr=True), transient=True),
        time.monotonic(),
    )
    task = progress.add_task(description, total=len(items), rate="")
    try:
        for count, item in enumerate(items):
            elapsed = time.monotonic() - start
            if elapsed > PATIENCE_S:
                progress.start()  # does nothing when it runs already
                progress.update(task, completed=count, rate=f"{count / elapsed:.1f}")
            yield item
    finally:
        progress.stop()


def peak_memory_bytes() -> int:
    """Largest resident size of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


class Stopwatch:
    """seconds: by the name of the stage, in order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now
