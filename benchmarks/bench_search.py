"""Searching in product-quantised codes, beside FAISS, raw cosines and the limit of reading memory.

    python benchmarks/bench_search.py [--points 1000000] [--threads 1] [--rounds 9] [--json out.json]
        [--skip single|many|mapped] [--bytes 128 64 32] [--mapped-points 5000000 10000000]
        [--before LIBRARY]

Everything runs in one process and in turns; times are minima of wall time, and hold all that a caller waits for
(building tables too). Codes are drawn: time does not depend on them. Tables are as unequal as CLIP's: one part of a
query is far larger than the others.

--before: the file of an earlier native library, which takes turns with this one.

single: one query, all scores of all points, for 128, 64 and 32 bytes. many: 20 and 200 queries, the best of them for
each point. mapped: fields saved and loaded again: the first query after loading beside the next ones; also with the
file's pages dropped before (Linux), beside reading the file alone.
"""

import argparse
import json
import os
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from earlier import BEFORE, earlier, with_earlier
from machine import describe, interleaved
from search_rivals import Run, faiss_rivals, forced, raw_rivals, readers

from drsplat import Codebook, EncoderIdentity, LanguageField, load_field
from drsplat.field.codes import PQCode
from drsplat.kernels import available_isas, default_isa

AVX2, FAISS = "drsplat forced to AVX2 (v3)", "FAISS IndexPQ, top 100"
DIM = 512
PARTS = (128, 64, 32)
THINGS = 300
CHECKED = 100_000  # points whose scores are compared with float64
IDENTITY = EncoderIdentity("benchmark", DIM)
SWEPT_BYTES = 1 << 27  # more than any cache holds

Rows = dict[str, dict[str, float]]


def aligned(shape: tuple[int, ...]) -> np.ndarray:
    """Bytes that begin at a page of 2 MiB, as a mapped file does at one of 4 KiB."""
    count, page = int(np.prod(shape)), 1 << 21
    memory = np.empty(count + page, np.uint8)
    begin = -memory.ctypes.data % page
    return memory[begin : begin + count].reshape(shape)


def random_code(points: int, parts: int, seed: int = 0) -> PQCode:
    """Codes of things: those of one thing have three of five bytes in common."""
    rng = np.random.default_rng(seed)
    spread = rng.gamma(2, 0.5, (parts, 1, 1)) ** 0.5
    centroids = (rng.normal(size=(parts, 256, DIM // parts)) * spread / np.sqrt(DIM)).astype(np.float32)
    things = rng.integers(0, 256, (THINGS, parts, 1), np.uint8)
    grouped = aligned((-(-points // 256), parts, 256))
    for group in grouped:
        group[:] = rng.integers(0, 256, group.shape, np.uint8)
        thing = things[rng.integers(0, THINGS)]
        np.copyto(group, thing, where=rng.random(group.shape, np.float32) < 0.6)
    norms = rng.uniform(0.95, 1.0, points).astype(np.float32)
    return PQCode(Codebook(centroids, None, IDENTITY), grouped, None, norms)


def drawn_queries(count: int, seed: int = 1) -> np.ndarray:
    """Unit vectors with two numbers far larger than the others, as CLIP's."""
    queries = np.random.default_rng(seed).normal(size=(count, DIM))
    queries[:, 7] *= 12
    queries[:, 133] *= 9
    return (queries / np.linalg.norm(queries, axis=1, keepdims=True)).astype(np.float32)


def queries_of_things(code: PQCode, count: int) -> np.ndarray:
    """Each a third of the way from such a vector to some point's feature."""
    points = code.decode(np.linspace(0, len(code) - 1, count).astype(np.int64))
    queries = drawn_queries(count) + 0.5 * points
    return (queries / np.linalg.norm(queries, axis=1, keepdims=True)).astype(np.float32)


def largest_error(code: PQCode, query: np.ndarray, scores: np.ndarray) -> float:
    rows = np.arange(min(CHECKED, len(code)))
    decoded = code.codebook.decode(code.codes(rows)).astype(np.float64)
    exact = decoded @ query.astype(np.float64) * code.inverse_norms[rows]
    return float(abs(scores[rows] - exact).max())


def timed(rivals: dict[str, Run], rounds: int, args: argparse.Namespace) -> Rows:
    """Time each, with none of its codes in the cache, where the rival before may have left them."""
    clock = time.process_time if args.cpu else time.perf_counter
    others = np.ones(SWEPT_BYTES // 8)
    return {
        name: {"min_ms": 1e3 * float(s.min()), "median_ms": 1e3 * float(np.median(s))}
        for name, s in interleaved(rivals, rounds, clock, others.sum).items()
    }


def shown(title: str, rows: Rows, ours: str) -> None:
    print(f"\n{title}")
    least = rows[ours]["min_ms"]
    for name, row in sorted(rows.items(), key=lambda item: item[1]["min_ms"]):
        share = row["min_ms"] / least
        print(f"  {name:44s} {row['min_ms']:9.2f} ms  median {row['median_ms']:9.2f}  {share:7.2f} x")


def largest_errors(code: PQCode, query: np.ndarray, scan: Run) -> dict[str, float]:
    """By the instructions that the processor has, and by AVX2, NaN where it has none."""
    narrow = np.asarray(forced("v3", scan)()) if "v3" in available_isas() else None
    return {
        "default": largest_error(code, query, np.asarray(scan())),
        "v3": float("nan") if narrow is None else largest_error(code, query, narrow),
    }


def single(args: argparse.Namespace) -> dict[str, object]:
    """One query, every score."""
    found: dict[str, object] = {}
    query, threads = drawn_queries(1)[0], args.threads
    for parts in args.bytes:
        code = random_code(args.points, parts)
        ours = f"drsplat {default_isa()}"

        def scan(code: PQCode = code) -> np.ndarray:
            return code.scores(query[None], threads=threads)[0]

        rivals: dict[str, Run] = {ours: scan}
        if "v3" in available_isas() and default_isa() != "v3":
            rivals[AVX2] = forced("v3", scan)
        top = f"{ours}, top 100"
        rivals[top] = lambda code=code: code.top(query, 100, threads=threads)
        rivals |= before(args, rivals)
        cut = float(np.quantile(scan(), 0.99))
        rivals["drsplat, list of the best 1 %"] = lambda code=code, cut=cut: code.select(query, cut, threads=threads)
        rivals |= readers(code.grouped, threads) | faiss_rivals(code, query, threads)
        features = np.empty((0, 0))
        if parts == PARTS[0]:
            features = np.random.default_rng(2).standard_normal((args.points, DIM), np.float32)
            rivals |= raw_rivals(features, query, threads)
        rows = timed(rivals, args.rounds, args)
        shown(f"one query, {args.points:,} points of {parts} bytes, {threads} threads", rows, ours)
        limit = min(row["min_ms"] for name, row in rows.items() if name.startswith("read"))
        gigabytes = code.grouped.nbytes / limit / 1e6
        errors = largest_errors(code, query, scan)
        print(
            f"  read limit {limit:.2f} ms ({gigabytes:.0f} GB/s); ours is at {limit / rows[ours]['min_ms']:.0%} of it; "
            f"largest error {errors['default']:.1e} (v3: {errors['v3']:.1e})"
        )
        for name in (ours, AVX2) if {AVX2, FAISS} <= rows.keys() else ():
            faster, share = (other / rows[name]["min_ms"] for other in (rows[FAISS]["min_ms"], limit))
            print(f"  {name}: {faster:.2f} x FAISS IndexPQ, {share:.0%} of the read limit")
        found[str(parts)] = {"rows": rows, "read_limit_ms": limit, "largest_error": errors}
        del rivals, features
    return found


def before(args: argparse.Namespace, rivals: dict[str, Run]) -> dict[str, Run]:
    """The same by the earlier library, where one is given."""
    if args.before is None:
        return {}
    functions = earlier(args.before)
    return {f"{BEFORE}: {name}": with_earlier(functions, run) for name, run in rivals.items()}


def exact_best(code: PQCode, queries: np.ndarray) -> np.ndarray:
    """Decoded a block at a time, in float64 products of float32."""
    index = np.empty(len(code), np.int32)
    for begin in range(0, len(code), 1 << 15):
        rows = np.arange(begin, min(begin + (1 << 15), len(code)))
        index[rows] = (code.decode(rows).astype(np.float64) @ queries.T.astype(np.float64)).argmax(axis=1)
    return index


def decoded_best(code: PQCode, queries: np.ndarray) -> None:
    """The rival without tables: decode a block, one GEMM, its argmax."""
    for begin in range(0, len(code), 1 << 14):
        rows = np.arange(begin, min(begin + (1 << 14), len(code)))
        (code.decode(rows) @ queries.T).argmax(axis=1)


def many(args: argparse.Namespace) -> dict[str, object]:
    """The best of many queries for each point."""
    code, found = random_code(args.points, PARTS[0]), {}
    for count in (20, 200):
        queries = queries_of_things(code, count)
        ours = f"drsplat {default_isa()}"

        def best(queries: np.ndarray = queries) -> np.ndarray:
            return code.best(queries, threads=args.threads).index

        rivals: dict[str, Run] = {ours: best}
        slow: dict[str, Run] = {}
        if "v3" in available_isas() and default_isa() != "v3":
            slow[AVX2] = forced("v3", best)
        rivals |= before(args, rivals)
        if count == 20:
            slow["decode a block (NumPy), GEMM, argmax"] = lambda q=queries: decoded_best(code, q)
        rows = timed(rivals, max(3, args.rounds // (1 if count == 20 else 2)), args) | timed(slow, 1, args)
        shown(f"best of {count} queries, {args.points:,} points, {args.threads} threads", rows, ours)
        exact = exact_best(code, queries)
        agreement = float((best() == exact).mean())
        print(f"  the same query as in float64: {agreement:.2%} of points")
        found[str(count)] = {"rows": rows, "agreement": agreement}
    return found


def timed_once(run: Run) -> float:
    start = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - start)


def dropped(folder: Path) -> None:
    """Drop the pages of a folder's files, so that they are read from the disk again."""
    for path in folder.iterdir():
        with open(path, "rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def cold(folder: Path, query: np.ndarray, threads: int) -> dict[str, float]:
    """Milliseconds of a first query whose pages are on the disk, and of reading the largest file from there."""
    largest = max(folder.iterdir(), key=lambda path: path.stat().st_size)
    firsts, reads = [], []
    for _ in range(3):
        dropped(folder)
        field = load_field(folder)
        firsts.append(timed_once(lambda field=field: field.scores(query, threads=threads)))
        del field
        dropped(folder)
        content = np.memmap(largest, np.uint8, "r")
        whole = content[: content.size // 8 * 8].view(np.uint64)
        reads.append(timed_once(lambda whole=whole: whole.max()))
        del content, whole
    return {"cold_first_ms": min(firsts), "cold_read_ms": min(reads)}


def mapped(args: argparse.Namespace) -> dict[str, object]:
    """Saved, loaded, asked: nothing is converted on the way."""
    found: dict[str, object] = {}
    query = drawn_queries(1)[0]
    for points in args.mapped_points:
        folder = Path(tempfile.mkdtemp(dir=args.folder))
        try:
            code = random_code(points, PARTS[0])
            ids = np.arange(points, dtype=np.uint32)
            LanguageField(ids, code, IDENTITY, "benchmark", points).save(folder / "a.field")
            del code, ids
            firsts, loads, warm = [], [], []
            for _ in range(3):
                start = time.perf_counter()
                field = load_field(folder / "a.field")
                loads.append(time.perf_counter() - start)
                start = time.perf_counter()
                field.scores(query, threads=args.threads)
                firsts.append(time.perf_counter() - start)
                for _ in range(5):
                    start = time.perf_counter()
                    field.scores(query, threads=args.threads)
                    warm.append(time.perf_counter() - start)
            row = {"load_ms": 1e3 * min(loads), "first_ms": 1e3 * min(firsts), "warm_ms": 1e3 * min(warm)}
            print(
                f"\n{points:,} points, mapped: loaded and checked in {row['load_ms']:.0f} ms, first query "
                f"{row['first_ms']:.1f} ms, "
                f"next ones {row['warm_ms']:.1f} ms ({row['first_ms'] / row['warm_ms']:.2f} x); file in the page cache"
            )
            if hasattr(os, "posix_fadvise"):
                del field
                row |= cold(folder / "a.field", query, args.threads)
                print(
                    f"  pages dropped: first query {row['cold_first_ms']:.0f} ms, reading the file alone "
                    f"{row['cold_read_ms']:.0f} ms"
                )
            found[str(points)] = row
        finally:
            shutil.rmtree(folder)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--cpu", action="store_true", help="time of the processor, not of the clock: on a busy machine")
    parser.add_argument("--skip", action="append", default=[], choices=("single", "many", "mapped"))
    parser.add_argument("--bytes", type=int, nargs="*", default=PARTS, help="of a code, where one query is asked")
    parser.add_argument("--mapped-points", type=int, nargs="*", default=[5_000_000, 10_000_000])
    parser.add_argument("--folder", help="where --mapped-points are saved; else where the system has it")
    parser.add_argument("--before", metavar="LIBRARY")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()

    print(describe(), f"- instruction sets {', '.join(available_isas())}")
    found: dict[str, object] = {"machine": describe(), "threads": args.threads, "points": args.points}
    if "single" not in args.skip:
        found["single"] = single(args)
    if "many" not in args.skip:
        found["many"] = many(args)
    if "mapped" not in args.skip:
        found["mapped"] = mapped(args)
    if args.json is not None:
        args.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
