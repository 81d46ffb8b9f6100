"""What a command costs that starts from nothing: processor seconds of whole processes, in turns.

    drsplat demo --output-dir demo
    python benchmarks/bench_cold.py demo [--words "red vase"] [--rounds 9] [--before PYTHON]

One thread, and modules that are compiled already. --before: the interpreter of another environment with another
version of the package; both take turns. The interpreter itself and NumPy are printed too: no command with numbers can
take less.
"""

import os
import subprocess
import sys
from resource import RUSAGE_CHILDREN, getrusage

import numpy as np
from machine import arguments

THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def seconds_of(line: list[str]) -> float:
    """Processor seconds, user and system, of a process and of what it started."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = getrusage(RUSAGE_CHILDREN)
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, env=environment | THREADS)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    given = arguments(__doc__, "folder", words="red vase", rounds=9, before="")
    folder = str(given.folder)
    lines = {
        "python -c pass": ["-c", "pass"],
        "import numpy": ["-c", "import numpy"],
        "drsplat --help": ["-m", "drsplat", "--help"],
        "drsplat inspect": ["-m", "drsplat", "inspect", folder],
        "drsplat locate": ["-m", "drsplat", "locate", folder, given.words, "--threads", "1"],
    }
    pythons = ({"before": given.before} if given.before else {}) | {"now": sys.executable}
    turns = [(name, when) for name in lines for when in pythons]
    rounds = [
        {turn: seconds_of([pythons[turn[1]], *lines[turn[0]]]) for turn in turns} for _ in range(given.rounds + 1)
    ]
    print(f"CPU seconds, median of {given.rounds} (least)")
    print("| | " + " | ".join(pythons) + " |")
    print("|---" * (1 + len(pythons)) + "|")
    for name in lines:
        seconds = [[each[name, when] for each in rounds[1:]] for when in pythons]
        print(f"| `{name}` | " + " | ".join(f"{np.median(some):.3f} ({min(some):.3f})" for some in seconds) + " |")


if __name__ == "__main__":
    main()
