"""Peak memory and time of a whole registration: a million Gaussians, 200 views, 30,000 masks.

    python benchmarks/bench_memory.py [--gaussians 1000000] [--views 200] [--masks 150] [--dim 512]

Runs in this process from a clean start; the peak is the kernel's own count of resident memory.
"""

import resource
import tempfile
import time
from pathlib import Path

from machine import arguments
from rooms import SyntheticFeatures, room, room_views

from drsplat import Sampling


def peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    args = arguments(__doc__, gaussians=1_000_000, views=200, masks=150, dim=512, topk=40, threads=0)
    from drsplat import load_field, register

    views = room_views(args.views)
    features = SyntheticFeatures(views, args.masks, args.dim)
    clock = time.perf_counter()
    gaussians = room(args.gaussians)
    print(f"made the scene: {time.perf_counter() - clock:.1f} s, peak {peak_mib():,.0f} MiB")

    start = clock = time.perf_counter()
    registration = register(gaussians, views, features, sampling=Sampling(args.topk), threads=args.threads)
    took = time.perf_counter() - clock
    print(
        f"registered {args.views} views, {registration.weights.shape[1]:,} masks: {took:.1f} s, of which "
        f"{features.seconds:.1f} s made synthetic masks; {registration.weights.nnz:,} weights, "
        f"peak {peak_mib():,.0f} MiB"
    )

    clock = time.perf_counter()
    field = registration.to_field(threads=args.threads)
    print(
        f"coded {len(field.gaussian_ids):,} features: {time.perf_counter() - clock:.1f} s, peak {peak_mib():,.0f} MiB"
    )
    with tempfile.TemporaryDirectory() as folder:
        clock = time.perf_counter()
        field.save(Path(folder) / "room.field")
        size = sum(f.stat().st_size for f in (Path(folder) / "room.field").iterdir()) / 2**20
        print(f"saved {size:,.0f} MiB: {time.perf_counter() - clock:.1f} s")
        clock = time.perf_counter()
        scores = load_field(Path(folder) / "room.field").scores(registration.embeddings[0])
        print(f"loaded and scored {len(scores):,} Gaussians: {(time.perf_counter() - clock) * 1e3:.0f} ms")
    print(
        f"end to end without the masks: {time.perf_counter() - start - features.seconds:.1f} s; peak resident memory "
        f"{peak_mib():,.0f} MiB"
    )


if __name__ == "__main__":
    main()
