"""Milliseconds per view of the weight pass: by stage, by instruction set, by threads, beside a rival.

    python benchmarks/bench_registration.py [--rival splat.cpp] [--gaussians 500000] [--rounds 7]

The rival is the single-file C++ prototype this kernel replaced: it is built with g++ and run in this
process, in turns with ours, on the same arrays. All figures are minima and medians over the rounds.
"""

import argparse
import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from machine import describe, interleaved
from rooms import room, room_views, segment_map

from drsplat import _native
from drsplat.kernels import available_isas, splat_arrays, topk_contributions
from drsplat.kernels.splatting import _camera

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
        subprocess.run(
            ["g++", *RIVAL_FLAGS.split(), f"-march=x86-64-{level}", source, "-o", library],
            check=True,
        )
        self.lib = ctypes.CDLL(str(library))
        self.lib.ctx_new.restype = ctypes.c_void_p
        self.lib.peak_gflops.restype = ctypes.c_double
        self.contexts: dict[int, ctypes.c_void_p] = {}

    def run(self, splats, camera, segment_ids, k, threads, stats=False):
        context = self.contexts.setdefault(threads, ctypes.c_void_p(self.lib.ctx_new(threads)))
        view = RivalView()
        view.R[:], view.t[:] = camera[:9].tolist(), camera[9:12].tolist()
        view.fx, view.fy, view.cx, view.cy = camera[12:].tolist()
        view.H, view.W = segment_ids.shape
        times, counts = np.zeros(8), np.zeros(8, np.uint64)
        pointer = lambda a: a.ctypes.data_as(ctypes.c_void_p)  # noqa: E731
        size = self.lib.run_view(
            context,
            len(splats[2]),
            *map(pointer, splats),
            ctypes.byref(view),
            pointer(segment_ids),
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
        out = (
            np.empty(self.size, np.uint32),
            np.empty(self.size, np.uint32),
            np.empty(self.size, np.float32),
        )
        self.lib.get_out(self.context, *(a.ctypes.data_as(ctypes.c_void_p) for a in out))
        return out


def compare_tables(ours, theirs) -> str:
    key = lambda t: t[0].astype(np.int64) << 32 | t[1].astype(np.int64)  # noqa: E731
    a, b = key(ours), key(theirs)
    shared, i, j = np.intersect1d(a, b, return_indices=True)
    error = np.abs(ours[2][i].astype(float) - theirs[2][j]).sum() / theirs[2].sum()
    return f"{len(a) + len(b) - 2 * len(shared)} of {len(a)} keys differ, relative sum error {error:.1e}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rival", type=Path, help="the prototype's splat.cpp")
    parser.add_argument("--gaussians", type=int, default=500_000)
    parser.add_argument("--topk", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--segments", type=int, default=150)
    args = parser.parse_args()

    print(describe())
    gaussians, view = room(args.gaussians), room_views(8)[1]
    splats, camera = splat_arrays(gaussians), _camera(view)
    segment_ids = segment_map(view.width, view.height, args.segments, seed=1)
    hits = (topk_contributions(splats, view.resized(250, 182), 200).weights > 0).sum(-1)
    print(
        f"room of {args.gaussians:,} Gaussians, {view.width}x{view.height}, {args.segments} segments, "
        f"k = {args.topk}, {hits.mean():.0f} contributors per pixel"
    )

    stages: dict[str, list] = {}

    def ours(isa, threads):
        def run():
            result = _native.view_weights(*splats, camera, segment_ids, args.topk, 0, threads, isa)
            stages.setdefault(f"drsplat {isa} {threads}T", []).append(result[3])
            return result

        return run

    rivals = {f"drsplat {isa} {t}T": ours(isa, t) for isa in available_isas() for t in (1, 2)}
    with tempfile.TemporaryDirectory() as folder:
        built = {}
        if args.rival:
            aos = (
                np.ascontiguousarray(splats.means.T),
                np.ascontiguousarray(splats.covariances.T),
                splats.opacities,
            )
            for level in (isa for isa in available_isas() if isa in ("v3", "v4")):
                built[level] = Rival(args.rival, level, Path(folder))
                for threads in (1, 2):
                    name = f"rival {level} {threads}T"

                    def run(level=level, threads=threads, name=name):
                        stages.setdefault(name, []).append(
                            built[level].run(aos, camera, segment_ids, args.topk, threads)[0]
                        )

                    rivals[name] = run
        seconds = interleaved(rivals, args.rounds)
        print(
            f"\n{'ms per view':<18}"
            + "".join(f"{s:>11}" for s in STAGES)
            + f"{'total min':>12}{'median':>9}"
        )
        for name, total in seconds.items():
            parts = np.min(stages[name], 0) * 1e3
            print(
                f"{name:<18}"
                + "".join(f"{p:11.1f}" for p in parts)
                + f"{total.min() * 1e3:12.1f}{np.median(total) * 1e3:9.1f}"
            )
        best = available_isas()[0]
        single, double = seconds[f"drsplat {best} 1T"], seconds[f"drsplat {best} 2T"]
        print(
            f"\ntwo threads: {single.min() / double.min():.2f}x (minima), {np.median(single) / np.median(double):.2f}x (medians)"
        )
        for level, rival in built.items():
            for threads in (1, 2):
                a, b = seconds[f"drsplat {level} {threads}T"], seconds[f"rival {level} {threads}T"]
                print(
                    f"against the rival, {level}, {threads}T: {a.min() / b.min():.2f} of its time (minima), "
                    f"{np.median(a / b):.2f} (median of paired rounds)"
                )
            rival.run(aos, camera, segment_ids, args.topk, 1)
            print(f"tables, {level}: " + compare_tables(ours(level, 1)()[:3], rival.table()))
        if best in built:
            blocks = int(built[best].run(aos, camera, segment_ids, args.topk, 1, stats=True)[1][3])
            peak = built[best].lib.peak_gflops(50_000_000)
            composite = np.min(stages[f"drsplat {best} 1T"], 0)[3]
            bound = blocks * 16 * 26 / (peak * 1e9)
            print(
                f"bound: {blocks / 1e6:.2f} M block evaluations x 16 lanes x 26 flop at the measured {peak:.0f} GFLOP/s = "
                f"{bound * 1e3:.1f} ms, {bound / composite:.0%} of our compositing (which also selects the top k)"
            )


if __name__ == "__main__":
    main()
