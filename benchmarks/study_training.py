"""What each number of the everyday schedule gives, beside the original one: PSNR of held-out photos, and seconds.

    python benchmarks/study_training.py CAPTURE... --output FILE.jsonl [--resolution 504] [--seeds 1] [--threads 2]
        [--iterations 3600] [--only everyday original]

Every eighth photo is held out. "held out" and "trained on": PSNR in dB, mean over seeds, with the lowest and highest in
brackets where there are several. Seconds are those of the iterations, without finding points. --only: names of ways
(`WAYS`); all without it. --iterations: of the everyday schedule, which is stretched to them. FILE keeps a line for each
training: what is there is not trained again.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import drsplat as ds
from benchmarks.machine import describe
from drsplat.training import TrainingSettings, everyday, train
from drsplat.training.devices import DEFAULT_ITERATIONS, RATES

ORIGINAL_RATES = {name: getattr(TrainingSettings, name) for name in RATES}
EVERYDAY: dict[str, dict[str, Any]] = {
    "everyday": {},
    "photos at full size from the beginning": {"full_size_from": 0},
    "photos at full size from a quarter of the iterations": {"full_size_from": 900},
    "rates that do not fall at the end": {"rates_fall_from": 0},
    "no penalty of opacity": {"opacity_penalty": 0.0},
    "resets of opacity in place of the penalty": {
        "opacity_penalty": 0.0, "reset_every": 1200, "reset_recovery": 500,
    },
    "the original's rates": ORIGINAL_RATES,
    **{f"the original's {name}": {name: rate} for name, rate in ORIGINAL_RATES.items()},
    "degrees of 30,000 iterations": {"sh_degree_every": 1000},
    "no budget": {"max_gaussians": 10**8},
    "mcmc": {"strategy": "mcmc"},
    "harmonics of degree 2": {"sh_degree": 2},
    "2,500 iterations": {"iterations": 2500},
    "7,000 iterations": {"iterations": 7000},
}  # fmt: skip
ORIGINAL = {"original": False, "original, with the everyday budget": True}
WAYS = (*EVERYDAY, *ORIGINAL)
SHORT = 7000  # iterations of the original schedule


def settings_of(way: str, views: Sequence[ds.View], seed: int, iterations: int) -> TrainingSettings:
    if way in EVERYDAY:
        return everyday(views, **({"iterations": iterations} | EVERYDAY[way] | {"seed": seed}))
    budget = everyday(views).max_gaussians if ORIGINAL[way] else None
    return TrainingSettings(iterations=SHORT, seed=seed, max_gaussians=budget)


def trained(capture: str, way: str, seed: int, side: int, threads: int, iterations: int) -> dict[str, Any]:
    views = ds.read_views(capture, max_side=side)
    begin = time.process_time()
    settings, points = settings_of(way, views, seed, iterations), ds.read_sparse_points(capture)
    training = train(views, settings, points=points, threads=threads, device="cpu")
    measures = training.measures()
    kept = ("psnr_test", "psnr_train", "ssim_test", "num_gaussians", "seconds", "stage_seconds")
    return {name: measures[name] for name in kept} | {"cpu_seconds": time.process_time() - begin}


def _row(capture: str, way: str, runs: Sequence[dict[str, Any]]) -> str:
    def said(name: str, digits: int) -> str:
        values = np.array([run[name] for run in runs])
        spread = f" ({values.min():.{digits}f} to {values.max():.{digits}f})" if len(values) > 1 else ""
        return f"{values.mean():.{digits}f}{spread}"

    count = np.mean([run["num_gaussians"] for run in runs])
    seconds, cpu = (np.mean([run[name] for run in runs]) for name in ("seconds", "cpu_seconds"))
    shown = " | ".join((said("psnr_test", 2), said("psnr_train", 2), f"{count:,.0f}", f"{seconds:.0f} ({cpu:.0f})"))
    return f"| {Path(capture).name} | {way} | {shown} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--resolution", type=int, default=504)
    parser.add_argument("--iterations", type=int, default=DEFAULT_ITERATIONS)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=WAYS, default=list(WAYS), metavar="WAY")
    given = parser.parse_args()
    print(describe())
    lines = given.output.read_text(encoding="utf-8").splitlines() if given.output.is_file() else []
    known = {tuple(entry["of"]): entry for entry in map(json.loads, lines)}
    print("| capture | way | held out | trained on | Gaussians | seconds (CPU) |")
    print("|---|---|--:|--:|--:|--:|")
    for capture in given.captures:
        for way in given.only:
            runs = []
            for seed in range(given.seeds):
                key = (capture, way, seed, given.resolution, given.iterations)
                if key not in known:
                    known[key] = {"of": key} | trained(
                        capture, way, seed, given.resolution, given.threads, given.iterations
                    )
                    with given.output.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(known[key]) + "\n")
                runs.append(known[key])
            print(_row(capture, way, runs), flush=True)


if __name__ == "__main__":
    main()
