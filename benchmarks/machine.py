"""What a benchmark ran on, and how long something took."""

import os
import platform
import time
from collections.abc import Callable

import numpy as np


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


def interleaved(rivals: dict[str, Callable[[], object]], rounds: int) -> dict[str, np.ndarray]:
    """Seconds of each rival, `rounds` times in turns after one warm-up: noise falls on all alike."""
    for run in rivals.values():
        run()
    seconds = {name: np.empty(rounds) for name in rivals}
    for i in range(rounds):
        for name, run in rivals.items():
            start = time.perf_counter()
            run()
            seconds[name][i] = time.perf_counter() - start
    return seconds
