"""Milliseconds per view of the weight pass: by stage, by instruction set, by threads.

    python benchmarks/bench_registration.py [--gaussians 500000] [--rounds 7] [--isas v4 v3] [--cpu]
        [--before LIBRARY]

All figures are minima and medians over the rounds, which all take in turns. --cpu: of the processor's time, on a busy
machine; stages are of the clock. --before: the file of an earlier native library, which must give the same bits.
"""

import time
from collections.abc import Callable

import numpy as np
from earlier import BEFORE, earlier, with_earlier
from machine import arguments, interleaved
from rooms import mask_map, room, room_views

from drsplat import _native
from drsplat.kernels import available_isas, splat_arrays, topk_contributions
from drsplat.kernels.splats import camera_numbers

STAGES = ("project", "sort", "bin", "composite", "merge")


class Contest:
    """One view, the ways to compute its weights, and how long each stage took."""

    def __init__(self, gaussians: int, masks: int, topk: int) -> None:
        self.view, self.topk = room_views(8)[1], topk
        self.splats = splat_arrays(room(gaussians))
        self.camera = camera_numbers(self.view, self.splats.near)
        self.mask_ids = mask_map(self.view.width, self.view.height, masks, seed=1)
        self.stages: dict[str, list] = {}

    def ours(self, isa: str, threads: int, label: str = "drsplat") -> Callable[[], object]:
        def run() -> tuple:
            *triples, stages = _native.view_weights(
                *self.splats[:3], False, self.camera, self.mask_ids, self.topk, 0, threads, isa
            )
            self.stages.setdefault(f"{label} {isa} {threads}T", []).append(stages)
            return tuple(triples)

        return run

    def contributors(self) -> float:
        """Mean per pixel, at a quarter of the resolution."""
        small = self.view.resized(self.view.width // 4, self.view.height // 4)
        return float((topk_contributions(self.splats, small, 200).weights > 0).sum(-1).mean())

    def print_table(self, seconds: dict[str, np.ndarray]) -> None:
        print(f"\n{'ms per view':<18}" + "".join(f"{s:>11}" for s in STAGES), end="")
        print(f"{'total min':>12}{'median':>9}")
        for name, total in seconds.items():
            parts = "".join(f"{p:11.1f}" for p in np.min(self.stages[name], 0) * 1e3)
            print(f"{name:<18}{parts}{total.min() * 1e3:12.1f}{np.median(total) * 1e3:9.1f}")

    def check_bits(self, runs: dict[str, Callable[[], object]]) -> None:
        """Refuse an earlier library that gives other weights. Raises: SystemExit: it does."""
        for name, run in runs.items():
            if name.startswith(BEFORE):
                now = runs[name.replace(BEFORE, "drsplat")]
                if any(a.tobytes() != b.tobytes() for a, b in zip(run(), now(), strict=True)):
                    raise SystemExit(f"{name}: other bits")


def main() -> None:
    args = arguments(
        __doc__, gaussians=500_000, topk=40, rounds=7, masks=150, isas=list(available_isas()), cpu=False, before=str
    )
    contest, isas = Contest(args.gaussians, args.masks, args.topk), args.isas
    print(
        f"room of {args.gaussians:,} Gaussians, {contest.view.width}x{contest.view.height}, "
        f"{args.masks} masks, k = {args.topk}, {contest.contributors():.0f} contributors per pixel"
    )
    runs = {f"drsplat {isa} {t}T": contest.ours(isa, t) for isa in isas for t in (1, 2)}
    if args.before:
        functions = earlier(args.before)
        for isa in isas:
            for t in (1, 2):
                runs[f"{BEFORE} {isa} {t}T"] = with_earlier(functions, contest.ours(isa, t, BEFORE))
        contest.check_bits(runs)
    seconds = interleaved(runs, args.rounds, time.process_time if args.cpu else time.perf_counter)
    contest.print_table(seconds)
    one, two = seconds[f"drsplat {isas[0]} 1T"], seconds[f"drsplat {isas[0]} 2T"]
    print(f"\ntwo threads: {one.min() / two.min():.2f}x (minima), {np.median(one) / np.median(two):.2f}x (medians)")


if __name__ == "__main__":
    main()
