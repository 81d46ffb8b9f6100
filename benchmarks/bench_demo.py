"""CPU seconds of `drsplat demo` by stage.

    python benchmarks/bench_demo.py [--before PYTHON] [--rounds 2]

Each round is a process of its own, with one thread but for masks and embeddings, which take all cores. NumPy's BLAS has
one too: threads of it that wait for each other count as work, up to 4 s on a busy machine. --before: the interpreter of
another environment with another version of the package; both take turns. Seconds are minima over the rounds.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import process_time

from machine import describe

from drsplat import Scene, export_page
from drsplat.evaluation.demo import story

try:
    from drsplat.evaluation.demo.story import write_album
except ImportError:  # of a version before, with --before
    from drsplat.evaluation.demo.album import write_album  # type: ignore[import-not-found, no-redef]

ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class Processor:
    """As `drsplat.base.progress.Stopwatch`, of the processor's time."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.last = process_time()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap as that of a stage."""
        now = process_time()
        self.seconds[stage], self.last = now - self.last, now


def measure() -> dict[str, float]:
    """Return the seconds of each stage, and how many answers were right."""
    story.Stopwatch = Processor  # type: ignore[misc,assignment,attr-defined]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "demo"
        found, watch = story.tell(folder, threads=1), Processor()
        write_album(folder, found, overwrite=True)
        watch.lap("pictures")
        scene = Scene(found.field, found.gaussians, found.views, threads=1)
        export_page(
            folder / "index.html", scene, [one.probe.text for one in found.verdicts], edits="none", overwrite=True
        )
        watch.lap("page")
    return found.seconds | watch.seconds | {"right": sum(verdict.is_right for verdict in found.verdicts)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", metavar="PYTHON")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.alone:
        print(json.dumps(measure()))
        return
    print(describe())
    pythons = ({"before": args.before} if args.before else {}) | {"now": sys.executable}
    rounds: dict[str, list[dict[str, float]]] = {name: [] for name in pythons}
    for _ in range(args.rounds):
        for name, python in pythons.items():
            ran = subprocess.run([python, __file__, "--alone"], check=True, stdout=subprocess.PIPE, env=ONE_THREAD)
            rounds[name].append(json.loads(ran.stdout))
    print("| stage | " + " | ".join(pythons) + " |")
    print("|---" * (1 + len(pythons)) + "|")
    for stage in rounds["now"][0]:
        print(f"| {stage} | " + " | ".join(f"{min(r[stage] for r in rounds[name]):.2f}" for name in pythons) + " |")


if __name__ == "__main__":
    main()
