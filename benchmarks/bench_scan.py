"""CPU seconds, memory and held-out PSNR of a whole `drsplat scan`, from photos to a page, by stage.

    python benchmarks/bench_scan.py PHOTOS [--before PYTHON] [--rounds 1] [--iterations N]

--before: the interpreter of another environment with another version of the package; both take turns. Poses are found
anew each time. Seconds are minima over the rounds; memory and PSNR are of the last one. The last rows are the wall's.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from machine import describe


def scanned(python: str, photos: str, iterations: list[str]) -> dict[str, Any]:
    """Scan, and return the command's own answer."""
    with tempfile.TemporaryDirectory() as place:
        line = ["scan", photos, "--output", str(Path(place) / "scan"), "--json", *iterations]
        ran = subprocess.run([python, "-m", "drsplat", *line], check=True, stdout=subprocess.PIPE, cwd=place)
    return dict(json.loads(ran.stdout))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", metavar="PHOTOS")
    parser.add_argument("--before", metavar="PYTHON")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--iterations", metavar="N")
    args = parser.parse_args()
    print(describe())
    pythons = ({"before": args.before} if args.before else {}) | {"now": sys.executable}
    rounds: dict[str, list[dict[str, Any]]] = {name: [] for name in pythons}
    for _ in range(args.rounds):
        for name, python in pythons.items():
            photos = str(Path(args.photos).resolve())
            rounds[name].append(scanned(python, photos, ["--iterations", args.iterations] if args.iterations else []))
    print("| CPU s | " + " | ".join(pythons) + " |")
    print("|---" * (1 + len(pythons)) + "|")

    def row(what: str, value: Any) -> None:
        print(f"| {what} | " + " | ".join(f"{value(rounds[name]):.1f}" for name in pythons) + " |")

    for stage in rounds["now"][0]["stage_cpu_seconds"]:
        row(stage, lambda ran, stage=stage: min(one["stage_cpu_seconds"].get(stage, 0) for one in ran))
    row("all", lambda ran: min(sum(one["stage_cpu_seconds"].values()) for one in ran))
    row("memory, MiB", lambda ran: ran[-1]["peak_memory_bytes"] / 2**20)
    row("held-out PSNR, dB", lambda ran: ran[-1]["psnr_test"])
    row("wall, s", lambda ran: min(one["seconds"] for one in ran))


if __name__ == "__main__":
    main()
