"""Milliseconds per training iteration: by stage, scene size, image size and threads, beside a rival.

    python benchmarks/bench_training.py [--gaussians 50000 100000 300000] [--sizes 400x300 800x600]
                                        [--threads 1 2] [--sh-degree 3] [--rounds 12]
                                        [--rival-gaussians 1000] [--rival-size 96x72]

An iteration is a forward pass, the photometric loss, the backward pass and an Adam step on every
parameter; each round takes another camera of a furnished room. Figures are medians over the rounds;
of the whole also the least, and the least CPU time of all threads, which a busy machine distorts less. The harmonics
take their Adam step in the backward pass. Beside an earlier version: in_turns.py --before PYTHON bench_training.py.

The rival is the plain dense rasterizer of the tests in torch, on the CPU with autograd and torch's own
Adam (pip install torch): every Gaussian at every pixel. It runs in turns with ours, on the same scene, of
a size that it can bear; --rival-gaussians 0 leaves it out.
"""

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from machine import describe, interleaved
from rooms import room, room_views

from drsplat import View
from drsplat.kernels.training import Rates, SceneParameters, forward, photometric_loss
from drsplat.training.optimizer import Optimizer

STAGES = ("project", "sort", "bin", "forward", "loss", "backward", "adam", "other")
PARTS = {  # of the native pass, in the stages of the table
    "project": ("activate", "project", "color"),
    "sort": ("sort",),
    "bin": ("bin",),
    "forward": ("forward",),
    "backward": ("backward", "parameters"),
}
RATES = {"means": 1.6e-4, "log_scales": 5e-3, "quats": 1e-3, "logits": 5e-2, "sh": 1.25e-4}
CONSTANT_RATE = 2.5e-3  # of the colours' constant term
BACKGROUND = np.zeros(3, np.float32)


class Training:
    """Scene, targets and moments; `step` is one iteration and keeps the seconds of its stages."""

    def __init__(self, scene: SceneParameters, views: list[View], degree: int) -> None:
        self.views, self.degree, self.count = views, degree, 0
        rng = np.random.default_rng(0)
        self.targets = [
            forward(scene, view, degree, BACKGROUND).image
            + rng.normal(0, 0.1, (view.height, view.width, 3)).astype(np.float32)
            for view in views
        ]
        self.scene = SceneParameters(*(column.copy() for column in scene))
        self.optimizer = Optimizer(self.scene)
        self.step_back = getattr(self.optimizer, "harmonics_step", None)  # which earlier versions have not
        self.seconds: dict[int, list[list[float]]] = {}

    def step(self, threads: int) -> None:
        view, target = (each[self.count % len(self.views)] for each in (self.views, self.targets))
        self.count += 1
        busy, clock = time.process_time(), [time.perf_counter()]
        seen = forward(self.scene, view, self.degree, BACKGROUND, threads=threads)
        clock.append(time.perf_counter())
        loss = photometric_loss(seen.image, target, threads=threads)
        clock.append(time.perf_counter())
        rates = Rates(**(RATES | {"sh": CONSTANT_RATE, "sh_rest": RATES["sh"]}))
        steps = [self.step_back(rates, self.count)] if self.step_back else []
        gradients = seen.backward(loss.gradient, *steps)
        clock.append(time.perf_counter())
        self.optimizer.step(gradients, rates, self.count, threads)
        clock.append(time.perf_counter())
        stages = stage_seconds(seen.seconds, np.diff(clock))
        self.seconds.setdefault(threads, []).append([*stages, time.process_time() - busy])

    def table_row(self, threads: int, rounds: int) -> np.ndarray:
        """Milliseconds: medians of each stage and of the whole, the least of the whole, its CPU time."""
        rows = np.array(self.seconds[threads][-rounds:]) * 1e3
        stages, busy = rows[:, :-1], rows[:, -1]
        totals = stages.sum(axis=1)
        return np.array([*np.median(stages, axis=0), np.median(totals), totals.min(), busy.min()])


def stage_seconds(native: dict[str, float], calls: np.ndarray) -> list[float]:
    """In the order of STAGES. Other: what the calls took beyond their stages (memory, mostly)."""
    stages = {stage: sum(native[part] for part in parts) for stage, parts in PARTS.items()}
    stages |= {"loss": calls[1], "adam": calls[3]}
    stages["other"] = calls.sum() - sum(stages.values())
    return [stages[name] for name in STAGES]


def furnished(count: int, degree: int) -> SceneParameters:
    """The room before activation, with faint view-dependent colours."""
    scene, rng = room(count), np.random.default_rng(1)
    sh = rng.normal(0, 0.05, (count, (degree + 1) ** 2, 3))
    sh[:, :1] = scene.sh
    logits = np.log(scene.opacities / (1 - scene.opacities))
    columns = (scene.means, np.log(scene.scales), scene.quats, logits, sh)
    return SceneParameters(*(np.ascontiguousarray(column, np.float32) for column in columns))


def size_of(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def rival_step(training: Training, threads: int) -> Callable[[], None]:
    """The same iteration in torch, on its own copy of the scene."""
    import torch

    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/support"))
    import dense_torch

    leaves = dense_torch.Scene(*(torch.tensor(column, requires_grad=True) for column in training.scene))
    rates = [RATES[name] for name in training.scene._fields]
    optimizer = torch.optim.Adam(
        [{"params": [leaf], "lr": rate} for leaf, rate in zip(leaves, rates, strict=True)], eps=1e-15
    )
    targets = [torch.tensor(target) for target in training.targets]
    behind, counter = torch.tensor(BACKGROUND), iter(range(1 << 30))

    def step() -> None:
        torch.set_num_threads(threads)
        i = next(counter) % len(targets)
        optimizer.zero_grad()
        dense = dense_torch.render(leaves, training.views[i], training.degree, behind)
        dense_torch.photometric_loss(dense.image, targets[i]).backward()
        optimizer.step()

    return step


def measure(args: argparse.Namespace) -> None:
    heads = "".join(f"{name:>10}" for name in (*STAGES, "total", "least", "CPU"))
    print(f"{'Gaussians':>10}{'size':>10}{'threads':>9}{heads}   ms")
    for count in args.gaussians:
        scene = furnished(count, args.sh_degree)
        for size in args.sizes:
            training = Training(scene, room_views(8, *size), args.sh_degree)
            rivals = {str(t): partial(training.step, t) for t in args.threads}
            interleaved(rivals, args.rounds)
            for threads in args.threads:
                row = "".join(f"{ms:10.1f}" for ms in training.table_row(threads, args.rounds))
                print(f"{count:>10,}{f'{size[0]}x{size[1]}':>10}{threads:>9}{row}", flush=True)


def compare(args: argparse.Namespace) -> None:
    """Ours and the rival, in turns, on one small scene."""
    width, height = args.rival_size
    training = Training(furnished(args.rival_gaussians, args.sh_degree), room_views(8, width, height), args.sh_degree)
    rivals: dict[str, Callable[[], object]] = {}
    for threads in args.threads:
        rivals[f"drsplat {threads}"] = partial(training.step, threads)
        rivals[f"torch {threads}"] = rival_step(training, threads)
    seconds = {name: np.median(row) * 1e3 for name, row in interleaved(rivals, args.rival_rounds).items()}
    print(f"\na rival: {args.rival_gaussians:,} Gaussians, {width}x{height}, dense torch autograd")
    for threads in args.threads:
        ours, theirs = (seconds[f"{name} {threads}"] for name in ("drsplat", "torch"))
        print(f"{threads} threads: torch {theirs:,.1f} ms, drsplat {ours:.2f} ms, {theirs / ours:,.0f} times")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, nargs="*", default=[50_000, 100_000, 300_000])
    parser.add_argument("--sizes", type=size_of, nargs="*", default=[(400, 300), (800, 600)])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--sh-degree", type=int, default=3, choices=range(4))
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--rival-gaussians", type=int, default=1000)
    parser.add_argument("--rival-size", type=size_of, default=(96, 72))
    parser.add_argument("--rival-rounds", type=int, default=3)
    args = parser.parse_args()

    print(describe())
    print(f"room, SH degree {args.sh_degree}, medians of {args.rounds} rounds over 8 cameras")
    measure(args)
    if not args.rival_gaussians:
        return
    if importlib.util.find_spec("torch") is None:
        print("\nno rival: torch is not installed")
    else:
        compare(args)


if __name__ == "__main__":
    main()
