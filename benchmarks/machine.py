"""What a benchmark is told, what it ran on, and how long something took."""

import argparse
import gc
import os
import platform
import re
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def arguments(doc: str | None, *places: str, **defaults: object) -> argparse.Namespace:
    """Paths, and --name VALUE for each default, of its type; says what all this runs on.

    Of a list it takes several, of a tuple one or none, of a type one or none; False is a switch.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for place in places:
        parser.add_argument(place, type=Path)
    for name, default in defaults.items():
        how: dict[str, Any] = {"type": type(default), "default": default}
        if isinstance(default, list):
            how = {"type": type(default[0]), "default": default, "nargs": "*"}
        elif isinstance(default, type):
            how = {"type": default}
        elif isinstance(default, tuple):
            how = {"choices": default}
        elif default is False:
            how = {"action": "store_true"}
        parser.add_argument(f"--{name.replace('_', '-')}", **how)
    given = parser.parse_args()
    print(describe())
    return given


def describe() -> str:
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            model = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return (
        f"{model}, {os.cpu_count()} cores, load {load:.1f}, Python {platform.python_version()}, NumPy {np.__version__}"
    )


def interleaved(
    rivals: dict[str, Callable[[], object]],
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
    first: Callable[[], object] = lambda: None,
) -> dict[str, np.ndarray]:
    """Seconds of each rival, `rounds` times in turns after one warm-up: noise falls on all alike.

    clock: `time.process_time` leaves out what other programs take, on a machine that is not quiet. first: is called
    before each, and not counted.
    """
    for run in rivals.values():
        run()
    seconds = {name: np.empty(rounds) for name in rivals}
    for i in range(rounds):
        for name, run in rivals.items():
            first()
            start = clock()
            run()
            seconds[name][i] = clock() - start
    return seconds


def wait_for(port: int) -> None:
    """Wait up to a minute until a program on this machine takes connections at a port."""
    for _ in range(600):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise SystemExit("the service did not start")


def resident_mib(peak: bool) -> float:
    """MiB of memory that this process holds, or has held at most since `forget_peak`. NaN where Linux does not say."""
    field = "VmHWM" if peak else "VmRSS"
    try:
        found = re.search(rf"{field}:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="utf-8"))
    except OSError:
        found = None
    return int(found[1]) / 1024 if found else float("nan")


def forget_peak() -> None:
    gc.collect()
    Path("/proc/self/clear_refs").write_text("5")
