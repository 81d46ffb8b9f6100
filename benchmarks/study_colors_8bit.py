"""What viewers that keep constant colours in bytes show of a scene: PSNR of held-out photos, as we draw and as they do.

    python benchmarks/study_colors_8bit.py CAPTURE... --output FILE.jsonl [--resolution 504] [--iterations 4000]
        [--seeds 1] [--threads 1] [--only free]
    python benchmarks/study_colors_8bit.py CAPTURE --scene SCENE --output FILE.jsonl [--resolution 640]

The everyday schedule, every eighth photo held out, with constant colours free and within bytes (`WAYS`); with --scene a
scene that is there already. "drsplat": as `render` draws. "viewer": constant colours are rounded to bytes, harmonics
added, and colours clamped again, as Spark and GaussianSplats3D do. "fitted": the same viewer after `fitted_to_8_bits`.
"clamped": share of Gaussians whose constant colours a byte does not hold. PSNR in dB, mean over photos and seeds. FILE
keeps a line for each scene: what is there is not trained again.
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
from drsplat.kernels import sh_colors
from drsplat.scene.eight_bits import clamped_in_bytes, fitted_to_8_bits, in_bytes
from drsplat.scene.gaussians import SH_C0
from drsplat.training import everyday, train
from drsplat.training.metrics import psnr
from drsplat.training.training_photos import TrainingPhotos

WAYS: dict[str, dict[str, Any]] = {"free": {"colors_in_bytes": False}, "within bytes": {"colors_in_bytes": True}}
EVERY, MEMORY = 8, 1 << 30


def as_a_viewer_draws(gaussians: ds.Gaussians, view: ds.View) -> ds.Gaussians:
    """Return Gaussians of degree 0 that look from the view as a viewer with 8-bit colours shows the scene."""
    colors = np.minimum(sh_colors(in_bytes(gaussians).sh, gaussians.means, view.center - gaussians.origin), 1)
    return replace(gaussians, sh=((colors - 0.5) / SH_C0)[:, None].astype(np.float32))


def measured(gaussians: ds.Gaussians, views: Sequence[ds.View], viewer: bool) -> float:
    """Mean PSNR of renderings against photos."""
    values, photos = [], TrainingPhotos(views, MEMORY)
    for index, view in enumerate(views):
        drawn = ds.render(as_a_viewer_draws(gaussians, view) if viewer else gaussians, view, threads=1)
        values.append(psnr(np.clip(drawn.rgb, 0, 1), photos[index].colors(), photos[index].unused))
    return float(np.mean(values))


def facts_of(gaussians: ds.Gaussians, views: Sequence[ds.View]) -> dict[str, Any]:
    return {
        "drsplat": measured(gaussians, views, viewer=False),
        "viewer": measured(gaussians, views, viewer=True),
        "fitted": measured(fitted_to_8_bits(gaussians), views, viewer=True),
        "clamped": float(clamped_in_bytes(gaussians).mean()),
        "gaussians": len(gaussians),
    }


def trained(capture: str, way: str, seed: int, given: argparse.Namespace) -> dict[str, Any]:
    views = ds.read_views(capture, max_side=given.resolution)
    settings = everyday(views, given.iterations, seed=seed, **WAYS[way])
    begin = time.process_time()
    training = train(views, settings, points=ds.read_sparse_points(capture), threads=given.threads, device="cpu")
    spent = time.process_time() - begin
    return facts_of(training.gaussians, views[::EVERY]) | {"cpu_seconds": spent}


def _row(capture: str, way: str, runs: Sequence[dict[str, Any]]) -> str:
    def mean(name: str) -> float:
        return float(np.mean([run[name] for run in runs]))

    decibels = " | ".join(f"{mean(name):.2f}" for name in ("drsplat", "viewer", "fitted"))
    spent = f"{mean('cpu_seconds'):.0f}" if "cpu_seconds" in runs[0] else ""
    return f"| {Path(capture).name} | {way} | {decibels} | {mean('clamped'):.1%} | {mean('gaussians'):,.0f} | {spent} |"


def made(capture: str, way: str, seed: int, given: argparse.Namespace) -> dict[str, Any]:
    if given.scene is None:
        return trained(capture, way, seed, given)
    return facts_of(ds.read_gaussians(given.scene), ds.read_views(capture, max_side=given.resolution)[::EVERY])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--scene")
    parser.add_argument("--resolution", type=int, default=504)
    parser.add_argument("--iterations", type=int, default=4000)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=list(WAYS), default=list(WAYS))
    given = parser.parse_args()
    print(describe())
    lines = given.output.read_text(encoding="utf-8").splitlines() if given.output.is_file() else []
    known = {tuple(entry["of"]): entry for entry in map(json.loads, lines)}
    print("| capture | constant colours | drsplat | viewer | fitted, viewer | clamped | Gaussians | CPU seconds |")
    print("|---|---|" + "--:|" * 6)
    for capture in given.captures:
        for way in ["as they are"] if given.scene else given.only:
            runs = []
            for seed in range(given.seeds):
                key = (capture, way, seed, given.resolution, given.iterations, given.scene)
                if key not in known:
                    known[key] = {"of": key} | made(capture, way, seed, given)
                    with given.output.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(known[key]) + "\n")
                runs.append(known[key])
            print(_row(capture, way, runs), flush=True)


if __name__ == "__main__":
    main()
