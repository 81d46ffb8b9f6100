"""One display of progress for all stages of a scan, with the remaining time of the whole."""

import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from ...base.progress import Meter, duration, followed

ONE_METER_STAGES = ("train", "embed")  # one meter counts all of their work


class Cost(NamedTuple):
    """Time of a stage, with the processes that it started."""

    seconds: float
    cpu_seconds: float


class Display:
    """Progress of stages that follow each other, on stderr; nothing where `quiet`.

    expected: seconds of each stage, in order; only their ratios count as soon as one has ended.
    """

    def __init__(self, expected: Mapping[str, float], *, quiet: bool = False) -> None:
        self.expected, self._quiet = dict(expected), quiet
        self.costs: dict[str, Cost] = {}
        self._stage, self._job, self._begin = "", "", time.monotonic()
        self._meter, self._shown = Meter("", 0), ExitStack()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Show the meters of the block as those of a stage, and record its cost."""
        cpu = sum(os.times()[:4])  # of this process and of the child processes that have ended
        self._stage, self._job, self._begin = name, "", time.monotonic()
        with self._shown, followed(self._update):
            yield
        self.costs[name] = Cost(time.monotonic() - self._begin, sum(os.times()[:4]) - cpu)

    def say(self, name: str, text: str) -> None:
        """Print a line about a stage."""
        if not self._quiet:
            print(f"{self._number(name)} {text}", file=sys.stderr, flush=True)

    def tell(self, text: str) -> None:
        """Print a line about the scan."""
        if not self._quiet:
            print(f"drsplat: {text}", file=sys.stderr, flush=True)

    def _number(self, name: str) -> str:
        return f"{list(self.expected).index(name) + 1}/{len(self.expected)} {name}:"

    def _update(self, job: str, done: int, total: int, text: str) -> None:
        if job != self._job:
            self._shown.close()
            meter = Meter(f"{self._number(self._stage)} {job}", total, quiet=self._quiet)
            self._job, self._meter = job, self._shown.enter_context(meter)
        whole = f"about {duration(self.seconds_left(self._meter.left(done)[0]))} for all"
        self._meter.draw(done, "  ".join(filter(None, (whole, text))))

    def seconds_left(self, job_left: float) -> float:
        """Return the remaining time of all stages. job_left: of the meter that moves now."""
        # how many times longer stages take here than expected
        expected = sum(self.expected[name] for name in self.costs)
        pace = sum(cost.seconds for cost in self.costs.values()) / expected if expected else 1.0
        names = list(self.expected)
        later = sum(self.expected[name] for name in names[names.index(self._stage) + 1 :])
        own = self.expected[self._stage] * pace - (time.monotonic() - self._begin)
        return (job_left if self._stage in ONE_METER_STAGES else max(job_left, own)) + later * pace
