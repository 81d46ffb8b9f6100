"""Training, registration and rendering on a GPU, beside the CPU and beside gsplat where it is installed.

    python benchmarks/bench_cuda.py CAPTURE [--resolution 504] [--iterations 7000] [--gaussians 1000000] [--views 200]

A capture of photos with poses and points. It is trained with the original's settings; then it is grown to so many
Gaussians (strategy mcmc), whose steps at 1600x1064 and whose registration at 1000x730, k = 40, with made-up masks are
timed. Kernels are compiled anew, into an empty folder. Times are of the host's clock, with nothing left to do on the
GPU; those by kernel are of CUDA's events, one kernel after the other. Memory is what CuPy has taken.
"""

import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
from machine import arguments

import drsplat as ds
from drsplat.kernels import render_channels, splat_arrays, view_weights
from drsplat.kernels.cuda import using_device
from drsplat.kernels.cuda.devices import on_host
from drsplat.kernels.cuda.engine import cuda_engine
from drsplat.training.device_run import DeviceRun
from drsplat.training.optimizer import Optimizer
from drsplat.training.run import Beginning
from drsplat.training.start import first_gaussians, local_capture, split_views

TRAINED, REGISTERED, TOPK = (1600, 1064), (1000, 730), 40
MASKS, MASK_SIDE, WORDS = 60, 100, 512
GROWING = ds.TrainingSettings(
    iterations=10**6, strategy="mcmc", refine_from=100, refine_every=25, growth=0.1, sh_degree_every=100,
    max_gaussians=4,
)  # fmt: skip


def peak_mib() -> int:
    """MiB that CuPy has taken, and forget them."""
    pool = cuda_engine().xp.get_default_memory_pool()
    taken = pool.total_bytes() >> 20
    pool.free_all_blocks()
    return taken


def milliseconds(work: Callable[[], object], times: int) -> float:
    """Of one of so many calls, with nothing left to do on the GPU."""
    synchronize = cuda_engine().xp.cuda.Device().synchronize
    synchronize()
    begin = time.perf_counter()
    for _ in range(times):
        work()
    synchronize()
    return 1e3 * (time.perf_counter() - begin) / times


@contextmanager
def kernels_timed(times: int) -> Iterator[None]:
    """Print milliseconds of each kernel, of one of so many calls."""
    engine: Any = cuda_engine()
    event, launch, spent = engine.xp.cuda.Event, engine.launch, defaultdict(float)

    def timed(kernel: str, *rest: object, **more: object) -> None:
        begin, end = event(), event()
        begin.record()
        launch(kernel, *rest, **more)
        end.record()
        end.synchronize()
        spent[kernel] += engine.xp.cuda.get_elapsed_time(begin, end) / times

    engine.launch = timed
    yield
    del engine.launch
    most = sorted(spent.items(), key=lambda item: -item[1])
    print(f"    kernels {sum(spent.values()):.2f}: " + ", ".join(f"{name} {value:.2f}" for name, value in most))


def trained(args) -> None:
    views, points = ds.read_views(args.capture, max_side=args.resolution), ds.read_sparse_points(args.capture)
    settings = ds.TrainingSettings(iterations=args.iterations)
    for cache in ("empty cache", "again"):
        begin = time.perf_counter()
        done = ds.train(views, settings, points=points, device="cuda")
        print(
            f"training, {cache}: {done.seconds:.1f} s of iterations, {time.perf_counter() - begin:.1f} s in all, "
            f"{len(done.gaussians):,} Gaussians, PSNR {done.evaluation.psnr:.2f}, {peak_mib()} MiB"
        )


class Grown:
    """The capture, grown to so many Gaussians."""

    def __init__(self, args) -> None:
        views, points = ds.read_views(args.capture), ds.read_sparse_points(args.capture)
        settings = replace(GROWING, max_gaussians=args.gaussians)
        split, points, self.origin = local_capture(split_views(views, settings.test_every), points)
        self.views, optimizer = split.train, Optimizer(first_gaussians(points, settings))
        run = self.begun(optimizer, settings, self.views)
        while len(run) < args.gaussians:
            run.step()
        for _ in range(300):
            run.step()
        self.scene, self.optimizer = run.gaussians(), copied(run.optimizer)

    def begun(self, optimizer: Optimizer, settings: ds.TrainingSettings, views: list[ds.View]) -> DeviceRun:
        return DeviceRun(self.beginning(optimizer, settings, views), cuda_engine())

    def beginning(self, optimizer: Optimizer, settings: ds.TrainingSettings, views: list[ds.View]) -> Beginning:
        return Beginning(views, settings, optimizer, np.random.default_rng(0), self.origin)


def copied(optimizer: Optimizer) -> Optimizer:
    """On the host."""
    copy = Optimizer(type(optimizer.parameters)(*(on_host(part).copy() for part in optimizer.parameters)))
    copy.first, copy.second = (
        type(moment)(*(on_host(part).copy() for part in moment)) for moment in (optimizer.first, optimizer.second)
    )
    return copy


def stepped(grown: Grown) -> None:
    views = [replace(view.resized(*TRAINED), distortion=None) for view in grown.views[:24]]  # gsplat's has no edges
    settings = ds.TrainingSettings(iterations=10**6, refine_from=10**6, sh_degree_every=1)
    beginning = grown.beginning(copied(grown.optimizer), settings, views)
    ours = DeviceRun(beginning, cuda_engine())
    milliseconds(ours.step, 48)
    peak_mib()
    each = [milliseconds(ours.step, 96)]
    memory = peak_mib()
    with kernels_timed(20):
        milliseconds(ours.step, 20)
    if find_spec("gsplat") is not None:
        from suite.rivals.gsplat_training import GsplatRun

        theirs = GsplatRun(grown.beginning(copied(grown.optimizer), settings, views))
        milliseconds(theirs.step, 48)
        rival = milliseconds(theirs.step, 96)
        each.append(milliseconds(ours.step, 96))
        print(f"gsplat: {rival:.2f} ms an iteration, {rival / np.mean(each):.2f} times ours")
    both = " and ".join(f"{one:.2f}" for one in each)
    print(f"ours: {both} ms an iteration, {1e3 / each[0]:.0f} in a second, {memory} MiB")


def registered(grown: Grown, num_views: int) -> None:
    views = [view.resized(*REGISTERED) for view in grown.views]
    views = [replace(views[i % len(views)], name=f"{i}") for i in range(num_views)]
    rng = np.random.default_rng(0)
    cells = rng.integers(-1, MASKS, (-(-REGISTERED[1] // MASK_SIDE), -(-REGISTERED[0] // MASK_SIDE)))
    masks = np.kron(cells, np.ones((MASK_SIDE, MASK_SIDE), np.int32))[: REGISTERED[1], : REGISTERED[0]].astype(np.int32)
    values = rng.random((len(grown.scene), 3), np.float32)
    here, spent = splat_arrays(grown.scene), {}
    with using_device("cuda"):
        there = splat_arrays(grown.scene)
    for name, splats, count in (("GPU", there, 40), ("CPU", here, 8)):
        some = views[:count]
        view_weights(splats, some[0], masks, TOPK)
        render_channels(splats, some[0], values)
        begin = time.perf_counter()
        for view in some:
            view_weights(splats, view, masks, TOPK)
        middle = time.perf_counter()
        for view in some:
            render_channels(splats, view, values)
        spent[name] = [1e3 * (middle - begin) / count, 1e3 * (time.perf_counter() - middle) / count]
    for name, gpu, cpu in zip(("weights", "rendering"), spent["GPU"], spent["CPU"], strict=True):
        print(f"{name} of a view: {gpu:.2f} ms on the GPU, {cpu:.1f} on the CPU, {cpu / gpu:.1f} times")
    with kernels_timed(20):
        for view in views[:20]:
            view_weights(there, view, masks, TOPK)
    embeddings = rng.standard_normal((MASKS, WORDS)).astype(np.float32)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    features = {view.name: ds.ViewFeatures(masks, embeddings) for view in views}
    peak_mib()
    for device in ("cuda", "cpu"):
        begin = time.perf_counter()
        with using_device(device):
            entries = ds.register(grown.scene, views, features).evidence.weights.nnz
        print(f"{len(views)} views registered on {device}: {time.perf_counter() - begin:.1f} s, {entries:,} entries")
    print(f"registration: {peak_mib()} MiB")


def main() -> None:
    args = arguments(__doc__, "capture", resolution=504, iterations=7000, gaussians=1_000_000, views=200)
    os.environ["CUPY_CACHE_DIR"] = tempfile.mkdtemp()
    xp = cuda_engine().xp
    print(f"{xp.cuda.runtime.getDeviceProperties(0)['name'].decode()}, CuPy {xp.__version__}")
    trained(args)
    grown = Grown(args)
    stepped(grown)
    registered(grown, args.views)


if __name__ == "__main__":
    main()
