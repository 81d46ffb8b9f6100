"""Iterations per second of training on CUDA through gsplat, and how much of the time the GPU computes.

    python benchmarks/bench_gpu.py CAPTURE [--resolution 504] [--iterations 1500] [--timed 200]
                                           [--strategy default] [--max-gaussians 250000]

The scene is trained for so many iterations with the default settings; those after them are timed. The
share that the GPU computes is from torch's profiler, which slows the host, so it is given as time as well.
"""

import time
from collections.abc import Iterable

import numpy as np
import torch
from machine import arguments
from torch.profiler import ProfilerActivity, profile

import drsplat as ds
from drsplat.training import cuda
from drsplat.training.gsplat_loop import _full_precision
from drsplat.training.gsplat_run import DeviceRun
from drsplat.training.job import Beginning
from drsplat.training.optimizer import Optimizer
from drsplat.training.start import first_gaussians, local_capture, split_views


def begun(args) -> DeviceRun:
    views = ds.read_views(args.capture, max_side=args.resolution)
    budget = args.max_gaussians if args.strategy == "mcmc" else None
    settings = ds.TrainingSettings(strategy=args.strategy, max_gaussians=budget)
    split, points, origin = local_capture(split_views(views, settings.test_every), ds.read_sparse_points(args.capture))
    optimizer = Optimizer(first_gaussians(points, settings))
    beginning = Beginning(split.train, settings, optimizer, np.random.default_rng(0), origin)
    return DeviceRun(beginning, cuda.installed_engine())


def seconds_of(run: DeviceRun, iterations: int) -> float:
    torch.cuda.synchronize()
    start = time.perf_counter()
    for _ in range(iterations):
        run.step()
    torch.cuda.synchronize()
    return time.perf_counter() - start


def busy(spans: Iterable[tuple[float, float]]) -> float:
    """Length of the union of intervals."""
    total, end = 0.0, -np.inf
    for first, last in sorted(spans):
        total += max(last - max(first, end), 0.0)
        end = max(end, last)
    return total


def main() -> None:
    args = arguments(
        __doc__, "capture", resolution=504, iterations=1500, timed=200, strategy="default", max_gaussians=250_000
    )
    print(f"{torch.cuda.get_device_name()}, torch {torch.__version__}, CUDA {torch.version.cuda}")
    run = begun(args)
    with _full_precision():
        seconds_of(run, args.iterations)
        each = seconds_of(run, args.timed) / args.timed
        with profile(activities=[ProfilerActivity.CUDA]) as seen:
            seconds_of(run, args.timed // 4)
    events = [event.time_range for event in seen.events() if event.device_type.name == "CUDA"]
    computing = busy((span.start, span.end) for span in events) / (args.timed // 4) / 1e3
    print(
        f"{args.strategy}, {len(run.scene):,} Gaussians: {1 / each:.0f} iterations/s, {1e3 * each:.2f} ms, of which "
        f"the GPU computes {computing:.2f} ms in {4 * len(events) / args.timed:.0f} launches; "
        f"{torch.cuda.max_memory_allocated() / 2**30:.2f} GiB"
    )


if __name__ == "__main__":
    main()
