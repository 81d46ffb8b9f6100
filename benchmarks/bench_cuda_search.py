"""Searching in product-quantised codes on a GPU, beside the CPU and the GPU's memory bandwidth.

    python benchmarks/bench_cuda_search.py [--points 10000000] [--subvectors 128] [--rounds 20] [--cpu-points 1000000]
        [--emulated]

Codes are drawn on the GPU. Times are medians, of CUDA events around what runs on the GPU, and of wall time (marked)
where a caller waits for an answer on the host. The bandwidth is that of a copy from the GPU's memory to itself in the
same run, a byte read and a byte written. --emulated runs the kernels on the CPU, to try this script with few points.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import arguments

from drsplat.kernels import scan
from drsplat.kernels.cuda import scanning
from drsplat.kernels.cuda.engine import Engine, cuda_engine
from drsplat.kernels.scan import GROUP_ROWS, GroupedRows, QueryTables, RowShapes

QUERIES = 20  # among which the best is chosen
COPY_BYTES = 1 << 30
SHARE_ABOVE = 0.01  # rows that a threshold lets through


def emulated_engine() -> Engine:
    """Return the engine of the tests."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests/support"))
    from cuda_on_cpu import CpuEngine, compiled

    return CpuEngine(compiled(), 227 << 10)


def drawn_rows(engine: Engine, points: int, subvectors: int) -> scanning.DeviceRows:
    """Draw codes on the device."""
    xp = engine.xp
    shape = (-(-points // GROUP_ROWS), subvectors, GROUP_ROWS)
    xp.random.seed(0)
    codes = xp.random.randint(0, 256, shape, xp.uint8)
    norms = xp.random.uniform(0.95, 1.0, points).astype(xp.float32)
    engine.release()  # what drawing took
    return scanning.DeviceRows(engine, codes, norms, None, RowShapes(shape, points, None, 0))


def drawn_tables(subvectors: int, queries: int) -> QueryTables:
    """Draw tables whose sub-vectors differ in range, as CLIP's."""
    rng = np.random.default_rng(1)
    luts = rng.normal(size=(queries, subvectors, 256)) * rng.gamma(2, 0.5, (queries, subvectors, 1)) / subvectors
    return QueryTables(luts.astype(np.float32))


def device_ms(engine: Engine, run: Callable[[], object]) -> float:
    """Return milliseconds between CUDA events before and after a run."""
    if not hasattr(engine.xp, "cuda"):
        return wall_ms(engine, run)
    events = engine.xp.cuda.Event(), engine.xp.cuda.Event()
    events[0].record()
    run()
    events[1].record()
    events[1].synchronize()
    return float(engine.xp.cuda.get_elapsed_time(*events))


def wall_ms(engine: Engine, run: Callable[[], object]) -> float:
    """Return milliseconds that a caller waits."""
    if hasattr(engine.xp, "cuda"):
        engine.xp.cuda.Device().synchronize()
    start = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - start)


Clock = Callable[[Engine, Callable[[], object]], float]


def median_ms(engine: Engine, run: Callable[[], object], rounds: int, clock: Clock) -> float:
    """Return the median after a warm-up."""
    run()
    return float(np.median([clock(engine, run) for _ in range(rounds)]))


def shown(name: str, ms: float, note: str = "") -> None:
    print(f"  {name:48s} {ms:10.3f} ms  {note}", flush=True)


def copied_bytes_per_second(engine: Engine, num_bytes: int, rounds: int) -> float:
    """Return bytes read and written a second by a copy on the device."""
    source = engine.xp.zeros(num_bytes, engine.xp.uint8)
    target = engine.xp.empty_like(source)

    def copy() -> None:
        engine.xp.copyto(target, source)

    return 2e3 * num_bytes / median_ms(engine, copy, rounds, device_ms)


def on_device(engine: Engine, rows: scanning.DeviceRows, rounds: int) -> None:
    """Time the scan, and each kind of answer."""
    subvectors, points = rows.codes.shape[1], rows.num_rows
    many = drawn_tables(subvectors, QUERIES)
    tables = QueryTables(many.luts[:1])
    bandwidth = copied_bytes_per_second(engine, min(COPY_BYTES, rows.codes.nbytes), rounds)
    engine.release()
    luts, scores = engine.xp.asarray(tables.luts[0]), engine.xp.empty(points, engine.xp.float32)
    ms = median_ms(engine, partial(scanning.scanned, rows, luts, None, scores), rounds, device_ms)
    moved = rows.codes.nbytes + 8 * points
    share = moved / ms * 1e3 / bandwidth
    shown("scores of one query, left on the GPU", ms, f"{moved / ms / 1e6:.0f} GB/s, {share:.0%} of a copy's")
    print(f"  a copy's bandwidth: {bandwidth / 1e9:.0f} GB/s")
    cut = float(np.quantile(scanning.scan_scores(rows, tables), 1 - SHARE_ABOVE))
    floor = np.full(points, cut, np.float32)
    answers: dict[str, Callable[[], Any]] = {
        "scan_scores": partial(scanning.scan_scores, rows, tables),
        f"scan_above, {SHARE_ABOVE:.0%} of the rows": partial(scanning.scan_above, rows, tables, cut),
        "scan_above with a floor from the host": partial(scanning.scan_above, rows, tables, 0.0, floor),
        "scan_top, 100 rows": partial(scanning.scan_top, rows, tables, 100),
    }
    for name, run in answers.items():
        shown(f"{name} (wall time)", median_ms(engine, run, rounds, wall_ms))
    few = max(1, rounds // 7)
    shown(
        f"scan_best of {QUERIES} queries (wall time)",
        median_ms(engine, partial(scanning.scan_best, rows, many), few, wall_ms),
    )


def beside_the_cpu(engine: Engine, rows: scanning.DeviceRows, cpu_points: int) -> None:
    """Time the native kernels on the first rows, scaled to all, and compare the scores."""
    points = min(cpu_points, rows.num_rows)
    tables = drawn_tables(rows.codes.shape[1], 1)
    host = GroupedRows(
        scanning.on_host(rows.codes[: -(-points // GROUP_ROWS)]), scanning.on_host(rows.inverse_norms[:points])
    )
    ms = median_ms(engine, partial(scan.scan_scores, host, tables), 5, wall_ms)
    scale = rows.num_rows / points
    shown("CPU, scan_scores (wall time), all cores", ms * scale, f"measured on {points:,} points, times {scale:g}")
    ours, native = scanning.scan_scores(rows, tables)[0, :points], scan.scan_scores(host, tables)[0]
    print(f"  largest difference between GPU and CPU: {float(abs(ours - native).max()):.1e}")
    exact = host_scores(host, tables)
    print(f"  largest error of the GPU's scores: {float(abs(ours[: len(exact)] - exact).max()):.1e}")


def host_scores(host: GroupedRows, tables: QueryTables, most: int = 10_000) -> np.ndarray:
    """Return float64 scores of the first rows."""
    rows = np.arange(min(most, len(host.inverse_norms)))
    codes = scan.rows_of_groups(host.codes, rows)
    sums = tables.luts[0].astype(np.float64)[np.arange(codes.shape[1]), codes].sum(axis=1)
    return np.asarray(sums * host.inverse_norms[rows])


def main() -> None:
    args = arguments(__doc__, points=10_000_000, subvectors=128, rounds=20, cpu_points=1_000_000, emulated=False)
    engine = emulated_engine() if args.emulated else cuda_engine()
    if not args.emulated:
        print(engine.xp.cuda.runtime.getDeviceProperties(0)["name"].decode())
    rows = drawn_rows(engine, args.points, args.subvectors)
    print(f"{args.points:,} points of {args.subvectors} bytes, medians of {args.rounds}")
    on_device(engine, rows, args.rounds)
    beside_the_cpu(engine, rows, args.cpu_points)
    if not args.emulated:
        print(f"  peak memory of the GPU: {engine.xp.get_default_memory_pool().total_bytes() / 1e9:.2f} GB")


if __name__ == "__main__":
    main()
