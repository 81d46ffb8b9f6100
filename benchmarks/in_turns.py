"""Any benchmark by this version and by one before, in turns: each of its lines, with the numbers of both.

    python benchmarks/in_turns.py --before PYTHON [--rounds 3] bench_memory.py [OPTION]...

--before: the interpreter of another environment, with another version of the package; the script is this one's. Numbers
are medians over the rounds, then minima; lines whose numbers never differ stand once. Each run is a process of its own;
its CPU time and the most memory that it had are printed as well, with their ratios.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?")


class Run(NamedTuple):
    """lines: what a benchmark printed. cpu: seconds of all threads. mib: the most memory that it had."""

    lines: list[str]
    cpu: float
    mib: float


def ran(command: Sequence[str]) -> Run:
    """Run a benchmark. Raises: SystemExit: it fails."""
    with tempfile.TemporaryFile("w+", encoding="utf-8") as output:
        process = subprocess.Popen(command, stdout=output)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: ended with {process.returncode}")
        output.seek(0)
        lines = [line.rstrip() for line in output if line.strip()]
    return Run(lines, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def of_rounds(lines: Sequence[str]) -> str:
    """Return a line of several runs with the median of each number and, where they differ, the least."""
    told = [NUMBER.findall(line) for line in lines]
    numbers = iter(list(zip(*told, strict=True)) if len({len(some) for some in told}) == 1 else [])

    def shown(number: re.Match[str]) -> str:
        values = [float(text.replace(",", "")) for text in next(numbers, (number[0],))]
        places = len(number[0].partition(".")[2])
        middle, least = (f"{value:,.{places}f}" for value in (median(values), min(values)))
        return number[0] if len(set(values)) == 1 else middle if middle == least else f"{middle} (least {least})"

    return NUMBER.sub(shown, lines[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", metavar="PYTHON", required=True)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("script")
    parser.add_argument("options", nargs=argparse.REMAINDER)
    args = parser.parse_args()
    script = str(Path(__file__).parent / args.script)
    runs: dict[str, list[Run]] = {args.before: [], sys.executable: []}
    for _ in range(args.rounds):
        for python, done in runs.items():
            done.append(ran([python, script, *args.options]))
    before, now = runs.values()
    counts = {len(run.lines) for run in (*before, *now)}
    for number in range(max(counts)):
        texts = [
            of_rounds([run.lines[number] for run in some if number < len(run.lines)] or [""]) for some in runs.values()
        ]
        print(texts[1] if texts[0] == texts[1] else f"before: {texts[0]}\nnow:    {texts[1]}")
    for name, unit in (("cpu", "CPU seconds"), ("mib", "MiB at most")):
        was, is_ = ([getattr(run, name) for run in some] for some in (before, now))
        print(
            f"{unit}: before {median(was):,.1f} (least {min(was):,.1f}), now {median(is_):,.1f} ({min(is_):,.1f}); "
            f"ratio {median(is_) / median(was):.2f} of medians, {min(is_) / min(was):.2f} of minima"
        )


if __name__ == "__main__":
    main()
