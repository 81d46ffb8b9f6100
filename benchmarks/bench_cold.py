"""What a command costs that starts from nothing: processor seconds of whole processes, medians, in turns.

    drsplat demo --output-dir demo
    python benchmarks/bench_cold.py demo [--words "red vase"] [--rounds 9]

The interpreter itself and NumPy are printed too: no command with numbers can take less.
"""

import subprocess
import sys
from resource import RUSAGE_CHILDREN, getrusage

import numpy as np
from machine import arguments


def seconds_of(line: list[str]) -> float:
    """Processor seconds, user and system, of a process and of what it started."""
    before = getrusage(RUSAGE_CHILDREN)
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    given = arguments(__doc__, "folder", words="red vase", rounds=9)
    drsplat, folder = [sys.executable, "-m", "drsplat"], str(given.folder)
    lines = {
        "python -c pass": [sys.executable, "-c", "pass"],
        "import numpy": [sys.executable, "-c", "import numpy"],
        "drsplat --help": [*drsplat, "--help"],
        "drsplat inspect": [*drsplat, "inspect", folder],
        "drsplat locate": [*drsplat, "locate", folder, given.words, "--threads", "1"],
    }
    rounds = [{name: seconds_of(line) for name, line in lines.items()} for _ in range(given.rounds + 1)][1:]
    for name in lines:
        seconds = [each[name] for each in rounds]
        print(f"{name:16s} {np.median(seconds):6.3f} s of CPU, median of {given.rounds} (least {min(seconds):.3f})")


if __name__ == "__main__":
    main()
