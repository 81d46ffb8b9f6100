"""What processes take of the processor and of memory, while a benchmark watches them."""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

LOOK_S, FAMILY_S = 0.02, 0.5  # between two looks at the memory of processes, and at which they are


class Held(NamedTuple):
    """Bytes without and with the pages of mapped files."""

    own: int
    whole: int


class Cost(NamedTuple):
    """What a command took. own, whole: bytes at most, as of `Held`."""

    clock_s: float
    cpu_s: float
    own: int
    whole: int
    output: str


def held(pid: int) -> Held:
    """Return what a process holds, nothing if it is gone."""
    lines = _text(Path(f"/proc/{pid}/status")).splitlines()
    parts = (line.partition(":") for line in lines if line.endswith("kB"))
    bytes_of = {name: int(rest.split()[0]) << 10 for name, _, rest in parts}
    return Held(bytes_of.get("RssAnon", 0), bytes_of.get("VmRSS", 0))


def family(pid: int) -> list[int]:
    """Return a process and all below it."""
    lists = [_text(path) for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [pid, *(below for line in lists for child in line.split() for below in family(int(child)))]


def seconds_of_ended() -> float:
    """Return the processor's seconds of the processes of this one that have ended."""
    times = os.times()
    return times.children_user + times.children_system


class Watching(threading.Thread):
    """Look at the memory of some processes until `done`: own and whole, bytes that they hold together at most."""

    def __init__(self, pids: Callable[[], list[int]]) -> None:
        super().__init__(daemon=True)
        self.pids, self.own, self.whole, self.done = pids, 0, 0, threading.Event()
        self.start()

    def run(self) -> None:
        looked_at, pids = 0.0, []
        while not self.done.wait(LOOK_S):
            if time.monotonic() - looked_at > FAMILY_S:
                looked_at, pids = time.monotonic(), self.pids()
            sums = [held(pid) for pid in pids]
            self.own = max(self.own, sum(own for own, _ in sums))
            self.whole = max(self.whole, sum(whole for _, whole in sums))


def cost_of(
    command: Sequence[str],
    seconds: Callable[[], float] = seconds_of_ended,
    others: Callable[[], list[int]] = lambda: [],
) -> Cost:
    """Run a command and watch it until it ends. others: further processes that work for it."""
    start, before = time.perf_counter(), seconds()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    watching = Watching(lambda: [*family(process.pid), *others()])
    output, errors = process.communicate()
    watching.done.set()
    if process.returncode:
        raise SystemExit(f"{command}: {errors[-3000:]}")
    return Cost(time.perf_counter() - start, seconds() - before, watching.own, watching.whole, output)


def _text(path: Path) -> str:
    """Return nothing of a process or a thread that is gone."""
    try:
        return path.read_text()
    except OSError:
        return ""
