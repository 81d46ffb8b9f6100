"""Every aggregator beside the mean: time and memory of weighing the votes and of making all features.

    python benchmarks/bench_aggregators.py [--gaussians 300000] [--views 40] [--masks 150] [--dim 512]

The room and its masks are synthetic and have no meaning: this measures cost, not quality. "peak" is the
resident memory that an aggregator adds to that of the registration, which is there before (Linux only).
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from machine import arguments, forget_peak, resident_mib
from rooms import SyntheticFeatures, room, room_views

from benchmarks.suite.aggregators import MEASURED
from drsplat import Gaussians, register
from drsplat.field.evidence.aggregation import Aggregator, Sampling
from drsplat.field.evidence.evidence import Evidence

BLOCK = 8192


def measure(how: Aggregator, evidence: Evidence, gaussians: Gaussians, threads: int) -> str:
    forget_peak()
    before, start = resident_mib(peak=False), time.perf_counter()
    aggregated = how(evidence, gaussians, threads=threads)
    weighed = time.perf_counter()
    for begin in range(0, len(aggregated), BLOCK):
        aggregated.features(begin, min(begin + BLOCK, len(aggregated)), threads=threads)
    done, votes = time.perf_counter(), aggregated.evidence.weights.nnz
    return (
        f"{how.name:<24}{weighed - start:>10.2f}{done - weighed:>10.2f}{resident_mib(peak=True) - before:>10,.0f}"
        f"{votes:>14,}{aggregated.present.mean():>10.1%}"
    )


def main() -> None:
    args = arguments(__doc__, gaussians=300_000, views=40, masks=150, dim=512, threads=0)
    gaussians, views = room(args.gaussians), room_views(args.views)
    features = SyntheticFeatures(views, args.masks, args.dim)
    by_sampling: dict[Sampling, Evidence] = {}
    for how in MEASURED.values():
        sampling = how.sampling or Sampling()
        if sampling not in by_sampling:
            start, masks = time.perf_counter(), features.seconds
            registration = register(gaussians, views, features, sampling=sampling, threads=args.threads)
            took = time.perf_counter() - start - (features.seconds - masks)
            by_sampling[sampling] = registration.evidence
            print(f"registered {args.views} views, {sampling}: {took:.1f} s, {registration.weights.nnz:,} weights")
    print(f"{'aggregator':<24}{'weigh s':>10}{'features s':>10}{'peak MiB':>10}{'votes':>14}{'present':>10}")
    for how in MEASURED.values():
        print(measure(how, by_sampling[how.sampling or Sampling()], gaussians, args.threads))


if __name__ == "__main__":
    main()
