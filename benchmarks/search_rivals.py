"""What the search is measured against: FAISS, raw cosines, reading memory, and kernels of a prototype."""

import ctypes
import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drsplat.codes import PQCode

Run = Callable[[], object]
PREFETCH = 8192
WIDE = 16


def readers(codes: np.ndarray, threads: int) -> dict[str, Run]:
    """Ways to do no more than read all bytes; the fastest is the limit. Those of NumPy use one thread."""
    words = codes.reshape(-1).view(np.uint64)
    return {"read, u64 sum": words.sum, "read, u8 max": codes.reshape(-1).max} if threads == 1 else {}


def raw_rivals(features: np.ndarray, query: np.ndarray, threads: int) -> dict[str, Run]:
    """Cosines with features as they are: NumPy, and torch's half precisions where it is there."""
    rivals: dict[str, Run] = {"raw cosine, NumPy float32": lambda: features @ query}
    try:
        import torch
    except ImportError:
        return rivals
    torch.set_num_threads(threads)
    for name in ("float16", "bfloat16"):
        kind = getattr(torch, name)
        half, asked = torch.from_numpy(features).to(kind), torch.from_numpy(query).to(kind)
        rivals[f"raw cosine, torch {name}"] = lambda half=half, asked=asked: half @ asked
    return rivals


def faiss_rivals(code: PQCode, query: np.ndarray, threads: int) -> dict[str, Run]:
    """IndexPQ of the same codes, and IndexPQFastScan of as many bytes; none where FAISS is not installed."""
    try:
        import faiss
    except ImportError:
        return {}
    faiss.omp_set_num_threads(threads)
    parts, dim = code.codebook.num_subvectors, code.dim
    index = faiss.IndexPQ(dim, parts, 8, faiss.METRIC_INNER_PRODUCT)
    faiss.copy_array_to_vector(code.codebook.centroids.ravel(), index.pq.centroids)
    faiss.copy_array_to_vector(code.codes().codes.ravel(), index.codes)
    index.is_trained, index.ntotal = True, len(code)
    rivals = {"FAISS IndexPQ, top 100": lambda: index.search(query[None], 100)}
    if 2 * parts <= dim:
        fast = faiss.IndexPQFastScan(dim, 2 * parts, 4, faiss.METRIC_INNER_PRODUCT)
        rng = np.random.default_rng(0)
        fast.train(rng.normal(size=(2000, dim)).astype(np.float32))
        for begin in range(0, len(code), 1 << 16):  # what is in the codes does not change the time
            count = min(1 << 16, len(code) - begin)
            fast.add(rng.standard_normal((count, dim), np.float32))
        rivals["FAISS IndexPQFastScan 4 bit, top 100"] = lambda: fast.search(query[None], 100)
    return rivals


class Prototype:
    """Kernels compiled from a folder that has kern_pf.cpp, called as its own scripts call them."""

    def __init__(self, folder: Path, threads: int) -> None:
        target = Path(tempfile.mkdtemp()) / "prototype.so"
        flags = "-O3 -march=x86-64-v4 -mavx512vbmi -mavx512vnni -ffast-math -fopenmp -w -shared -fPIC"
        command = ["g++", *flags.split(), f"-DPFD={PREFETCH}", folder / "kern_pf.cpp", "-o", target]
        subprocess.run(command, check=True)
        self.native, self.threads = ctypes.CDLL(str(target)), threads

    def read(self, codes: np.ndarray) -> Run:
        return lambda: self.native.read_bw(_at(codes), ctypes.c_long(codes.nbytes), self.threads)

    def scores(self, code: PQCode, query: np.ndarray) -> Run:
        """Two byte planes, one step for all sub-vectors; its tables are built in NumPy and not timed."""
        grouped, norms, out, groups, parts = self._padded(code)
        luts, low, _ = _tables(code, query[None])
        step = (np.ptp(luts, axis=2).max(axis=1) / 65535).astype(np.float32)
        values = np.rint((luts - low) / step[:, None, None]).astype(np.uint16)
        planes = np.stack([values & 255, values >> 8], 1).astype(np.uint8)
        bias = low.sum((1, 2)).astype(np.float32)

        def run() -> np.ndarray:
            arrays = grouped, planes, step, bias, norms, out
            self.native.scan_vbmi16(*map(_at, arrays), groups, parts, 1, self.threads)
            return out

        return run

    def best(self, code: PQCode, queries: np.ndarray) -> Run:
        """Its hybrid: a high plane for the 16 sub-vectors of the widest range, 16 queries at a time."""
        grouped, norms, best, groups, parts = self._padded(code)
        luts, low, widths = _tables(code, queries)
        step = np.sort(widths, axis=1)[:, -WIDE - 1] / 255
        values = np.rint((luts - low) / step[:, None, None]).astype(np.int64)
        wide = np.argsort(-widths, axis=1)[:, :WIDE].astype(np.int32)
        high = np.take_along_axis(values, wide[:, :, None].astype(np.int64), 1) >> 8
        arrays = [
            grouped, (values & 255).astype(np.uint8), high.astype(np.uint8), np.ascontiguousarray(wide),
        ]  # fmt: skip
        scales = step.astype(np.float32), low.sum((1, 2)).astype(np.float32), norms
        index = np.empty(len(norms), np.uint16)

        def run() -> np.ndarray:
            self.native.argmax_hyb(
                *map(_at, arrays), WIDE, *map(_at, (*scales, index, best)),
                groups, parts, len(queries), 16, self.threads,
            )  # fmt: skip
            return index

        return run

    def _padded(self, code: PQCode) -> tuple[np.ndarray, np.ndarray, np.ndarray, ctypes.c_long, int]:
        """It knows whole groups only."""
        groups, parts, rows = code.grouped.shape
        norms = np.zeros(groups * rows, np.float32)
        norms[: len(code)] = code.inverse_norms
        return code.grouped, norms, np.empty_like(norms), ctypes.c_long(groups), parts


def vbmi_here() -> bool:
    try:
        return "avx512_vbmi" in Path("/proc/cpuinfo").read_text() or "avx512vbmi" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


def forced(isa: str, run: Run) -> Run:
    """The same on another instruction set."""

    def on_isa() -> object:
        os.environ["DRSPLAT_ISA"] = isa
        try:
            return run()
        finally:
            del os.environ["DRSPLAT_ISA"]

    return on_isa


def _tables(code: PQCode, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    luts = code.codebook.tables(queries).luts
    return luts, luts.min(axis=2, keepdims=True), np.ptp(luts, axis=2)


def _at(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
