"""Milliseconds per view of the weight pass: by stage, by instruction set, by threads, beside a rival.

    python benchmarks/bench_registration.py [--rival splat.cpp] [--gaussians 500000] [--rounds 7]

The rival is the single-file C++ prototype this kernel replaced: it is built with g++ and run in this
process, in turns with ours, on the same arrays. All figures are minima and medians over the rounds.
"""

import argparse
import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from machine import describe, interleaved
from rooms import mask_map, room, room_views

from drsplat import _native
from drsplat.kernels import available_isas, splat_arrays, topk_contributions
from drsplat.kernels.splatting import camera_numbers

STAGES = ("project", "sort", "bin", "composite", "merge")
RIVAL_FLAGS = "-O3 -std=c++17 -fPIC -shared -fno-math-errno -fno-trapping-math -ffp-contract=fast -Wno-psabi -pthread"


class RivalView(ctypes.Structure):
    _fields_ = [
        ("R", ctypes.c_float * 9),
        ("t", ctypes.c_float * 3),
        *((n, ctypes.c_float) for n in ("fx", "fy", "cx", "cy")),
        ("W", ctypes.c_int),
        ("H", ctypes.c_int),
    ]


class Rival:
    """The prototype's record-and-replay pass through its C interface."""

    def __init__(self, source: Path, level: str, folder: Path) -> None:
        library = folder / f"rival_{level}.so"
        subprocess.run(["g++", *RIVAL_FLAGS.split(), f"-march=x86-64-{level}", source, "-o", library], check=True)
        self.lib = ctypes.CDLL(str(library))
        self.lib.ctx_new.restype = ctypes.c_void_p
        self.lib.peak_gflops.restype = ctypes.c_double
        self.contexts: dict[int, ctypes.c_void_p] = {}

    def run(self, splats, camera, mask_ids, k, threads, stats=False):
        context = self.contexts.setdefault(threads, ctypes.c_void_p(self.lib.ctx_new(threads)))
        view = RivalView()
        view.R[:], view.t[:] = camera[:9].tolist(), camera[9:12].tolist()
        view.fx, view.fy, view.cx, view.cy = camera[12:].tolist()
        view.H, view.W = mask_ids.shape
        times, counts = np.zeros(8), np.zeros(8, np.uint64)
        pointer = lambda a: a.ctypes.data_as(ctypes.c_void_p)  # noqa: E731
        size = self.lib.run_view(
            context,
            len(splats[2]),
            *map(pointer, splats[:3]),
            ctypes.byref(view),
            pointer(mask_ids),
            0 if stats else -k,
            2,
            1,
            int(stats),
            pointer(times),
            pointer(counts),
        )
        self.size, self.context = size, context
        return times[:5], counts

    def table(self):
        out = (np.empty(self.size, np.uint32), np.empty(self.size, np.uint32), np.empty(self.size, np.float32))
        self.lib.get_out(self.context, *(a.ctypes.data_as(ctypes.c_void_p) for a in out))
        return out


def compare_tables(ours, theirs) -> str:
    key = lambda t: t[0].astype(np.int64) << 32 | t[1].astype(np.int64)  # noqa: E731
    a, b = key(ours), key(theirs)
    shared, i, j = np.intersect1d(a, b, return_indices=True)
    error = np.abs(ours[2][i].astype(float) - theirs[2][j]).sum() / theirs[2].sum()
    return f"{len(a) + len(b) - 2 * len(shared)} of {len(a)} keys differ, relative sum error {error:.1e}"


class Contest:
    """One view, everybody who computes its weights, and how long each stage took them."""

    def __init__(self, gaussians: int, masks: int, topk: int) -> None:
        self.view, self.topk = room_views(8)[1], topk
        self.splats = splat_arrays(room(gaussians))
        self.camera = camera_numbers(self.view, self.splats.near)
        self.mask_ids = mask_map(self.view.width, self.view.height, masks, seed=1)
        splats = self.splats
        self.rows = tuple(np.ascontiguousarray(a) for a in (splats.means.T, splats.covariances.T, splats.opacities))
        self.stages: dict[str, list] = {}

    def ours(self, isa: str, threads: int) -> Callable[[], tuple]:
        def run() -> tuple:
            *triples, stages = _native.view_weights(
                *self.splats[:3], self.camera, self.mask_ids, self.topk, 0, threads, isa
            )
            self.stages.setdefault(f"drsplat {isa} {threads}T", []).append(stages)
            return tuple(triples)

        return run

    def theirs(self, rival: Rival, level: str, threads: int) -> Callable[[], None]:
        def run() -> None:
            stages, _ = rival.run(self.rows, self.camera, self.mask_ids, self.topk, threads)
            self.stages.setdefault(f"rival {level} {threads}T", []).append(stages)

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

    def print_bound(self, rival: Rival, isa: str) -> None:
        counts = rival.run(self.rows, self.camera, self.mask_ids, self.topk, 1, stats=True)[1]
        blocks, peak = int(counts[3]), rival.lib.peak_gflops(50_000_000)
        bound = blocks * 16 * 26 / (peak * 1e9)
        share = bound / np.min(self.stages[f"drsplat {isa} 1T"], 0)[3]
        print(
            f"bound: {blocks / 1e6:.2f} M block evaluations x 16 lanes x 26 flop at the measured "
            f"{peak:.0f} GFLOP/s = {bound * 1e3:.1f} ms, {share:.0%} of our compositing (which also "
            "selects the top k)"
        )


def print_verdict(seconds: dict[str, np.ndarray], levels: Iterable[str]) -> None:
    for level in levels:
        for threads in (1, 2):
            a, b = seconds[f"drsplat {level} {threads}T"], seconds[f"rival {level} {threads}T"]
            print(
                f"against the rival, {level}, {threads}T: {a.min() / b.min():.2f} of its time "
                f"(minima), {np.median(a / b):.2f} (median of paired rounds)"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rival", type=Path, help="the prototype's splat.cpp")
    parser.add_argument("--gaussians", type=int, default=500_000)
    parser.add_argument("--topk", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--masks", type=int, default=150)
    args = parser.parse_args()

    print(describe())
    contest, isas = Contest(args.gaussians, args.masks, args.topk), available_isas()
    print(
        f"room of {args.gaussians:,} Gaussians, {contest.view.width}x{contest.view.height}, "
        f"{args.masks} masks, k = {args.topk}, {contest.contributors():.0f} contributors per pixel"
    )
    runs = {f"drsplat {isa} {t}T": contest.ours(isa, t) for isa in isas for t in (1, 2)}
    with tempfile.TemporaryDirectory() as folder:
        levels = [isa for isa in isas if isa in ("v3", "v4")] if args.rival else []
        rivals = {level: Rival(args.rival, level, Path(folder)) for level in levels}
        for level, rival in rivals.items():
            runs |= {f"rival {level} {t}T": contest.theirs(rival, level, t) for t in (1, 2)}
        seconds = interleaved(runs, args.rounds)
        contest.print_table(seconds)
        one, two = seconds[f"drsplat {isas[0]} 1T"], seconds[f"drsplat {isas[0]} 2T"]
        print(f"\ntwo threads: {one.min() / two.min():.2f}x (minima), ", end="")
        print(f"{np.median(one) / np.median(two):.2f}x (medians)")
        print_verdict(seconds, rivals)
        for level, rival in rivals.items():
            contest.theirs(rival, level, 1)()
            print(f"tables, {level}: {compare_tables(contest.ours(level, 1)(), rival.table())}")
        if isas[0] in rivals:
            contest.print_bound(rivals[isas[0]], isas[0])


if __name__ == "__main__":
    main()
