"""What antialiased training gives: PSNR of held-out photos at the resolution of training, and finer and coarser.

    python benchmarks/study_antialiasing.py CAPTURE... --output FILE.jsonl [--resolution 252] [--iterations 2000]
        [--seeds 1] [--threads 2]

The everyday schedule, every eighth photo held out. Each scene is trained at one resolution, with and without
`antialiased`, and drawn at others, against the photos at theirs: "as a plain scene" draws the antialiased one without
its mark, as programs do that do not know it. PSNR in dB, mean over photos and seeds. Seconds are those of the
iterations; the kinds are trained in turns. FILE keeps a line for each training: what is there is not trained again.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import drsplat as ds
from benchmarks.machine import describe
from drsplat.training import everyday, train
from drsplat.training.metrics import psnr
from drsplat.training.training_photos import TrainingPhotos

KINDS = {"plain": False, "antialiased": True}
SCALES = {"twice": 2.0, "as trained": 1.0, "half": 0.5, "quarter": 0.25}
EVERY, MEMORY = 8, 1 << 30


def measured(gaussians: ds.Gaussians, views: Sequence[ds.View]) -> float:
    """Mean PSNR of renderings against the photos, each at the size of its view."""
    values, photos = [], TrainingPhotos(views, MEMORY)
    for index, view in enumerate(views):
        drawn = np.clip(ds.render(gaussians, view).rgb, 0, 1)
        values.append(psnr(drawn, photos[index].colors(), photos[index].unused))
    return float(np.mean(values))


def trained(capture: str, kind: str, seed: int, given: argparse.Namespace) -> dict[str, Any]:
    views = ds.read_views(capture, max_side=given.resolution)
    settings = everyday(views, given.iterations, seed=seed, antialiased=KINDS[kind])
    begin = time.process_time()
    points = ds.read_sparse_points(capture)
    training = train(views, settings, points=points, threads=given.threads, device="cpu")
    facts: dict[str, Any] = {"cpu_seconds": time.process_time() - begin, "gaussians": len(training.gaussians)}
    for name, scale in SCALES.items():
        there = ds.read_views(capture, max_side=round(scale * given.resolution))[::EVERY]
        facts[name] = measured(training.gaussians, there)
        facts[f"{name}, unmarked"] = measured(replace(training.gaussians, antialiased=False), there)
    return facts


def _rows(capture: str, runs: dict[str, list[dict[str, Any]]]) -> None:
    def said(kind: str, names: Sequence[str]) -> str:
        return " | ".join(f"{np.mean([run[name] for run in runs[kind]]):.2f}" for name in names)

    for kind in KINDS:
        count, cpu = (np.mean([run[name] for run in runs[kind]]) for name in ("gaussians", "cpu_seconds"))
        print(f"| {Path(capture).name} | {kind} | {said(kind, list(SCALES))} | {count:,.0f} | {cpu:.0f} |")
    unmarked = [f"{name}, unmarked" for name in SCALES]
    print(f"| | antialiased, drawn as a plain scene | {said('antialiased', unmarked)} | | |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--resolution", type=int, default=252)
    parser.add_argument("--iterations", type=int, default=2000)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args()
    print(describe())
    lines = given.output.read_text(encoding="utf-8").splitlines() if given.output.is_file() else []
    known = {tuple(entry["of"]): entry for entry in map(json.loads, lines)}
    print(f"| capture | training | {' | '.join(SCALES)} | Gaussians | CPU seconds |")
    print("|---|---|" + "--:|" * (len(SCALES) + 2))
    for capture in given.captures:
        runs: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
        for seed in range(given.seeds):
            for kind in KINDS:
                key = (capture, kind, seed, given.resolution, given.iterations)
                if key not in known:
                    known[key] = {"of": key} | trained(capture, kind, seed, given)
                    with given.output.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(known[key]) + "\n")
                runs[kind].append(known[key])
        _rows(capture, runs)


if __name__ == "__main__":
    main()
