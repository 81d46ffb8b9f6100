"""What the search is measured against: FAISS, raw cosines and reading memory."""

import os
from collections.abc import Callable

import numpy as np

from drsplat.field.codes import PQCode

Run = Callable[[], object]


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


def forced(isa: str, run: Run) -> Run:
    """The same on another instruction set."""

    def on_isa() -> object:
        os.environ["DRSPLAT_ISA"] = isa
        try:
            return run()
        finally:
            del os.environ["DRSPLAT_ISA"]

    return on_isa
