"""Time and memory of finding objects, from a room's field up to a million Gaussians.

    python benchmarks/bench_objects.py [--gaussians 50000 200000 1000000] [--views 100] [--masks 300] [--threads 2]

A room of Gaussians with the statistics of a trained one (rooms.py). Each is seen in about 13 views, and lies in one
mask there, a few in two: `masks` cells of a grid over the room in each view, shifted from view to view. Times are of
finding them, without and with the description (boxes, descriptors); memory is the most that the process has beside
W, its masks and the Gaussians.
"""

import threading
import time
from pathlib import Path

import numpy as np
from machine import arguments
from rooms import room
from scipy.sparse import csr_array

from drsplat import EncoderIdentity, Gaussians, LanguageField, Registration
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.objects.choosing import choose
from drsplat.field.objects.finding import MIN_GAUSSIANS, find_objects, grow

SEEN, DIM, TWICE = 13, 64, 0.15


def registered(gaussians: Gaussians, num_views: int, masks: int, seed: int = 0) -> LanguageField:
    rng = np.random.default_rng(seed)
    count, side = len(gaussians), round(masks ** (1 / 3))
    low, high = gaussians.means.min(0), gaussians.means.max(0)
    columns = []
    for begin in range(0, SEEN):
        view = (rng.integers(0, num_views, count) // SEEN * SEEN + begin) % num_views
        shift = np.stack([np.sin(view + k) for k in range(3)], axis=1) * 0.1
        cell = np.clip(((gaussians.means - low) / (high - low) + shift) * side, 0, side - 1e-3).astype(np.int64)
        columns.append(view * masks + np.ravel_multi_index(tuple(cell.T), (side,) * 3) % masks)
        twice = rng.random(count) < TWICE
        columns.append(np.where(twice, view * masks + rng.integers(0, masks, count), columns[-1]))
    rows = np.tile(np.arange(count), len(columns))
    w = csr_array(
        (rng.random(len(rows), np.float32) + 0.1, (rows, np.concatenate(columns))), shape=(count, num_views * masks)
    )
    w.sum_duplicates()
    w.sort_indices()
    embeddings = rng.normal(size=(num_views * masks, DIM)).astype(np.float32)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    ids = MaskIds(
        tuple(f"{v:05d}.jpg" for v in range(num_views)),
        np.repeat(np.arange(num_views, dtype=np.int32), masks),
        np.tile(np.arange(masks, dtype=np.int32), num_views),
    )
    evidence = Evidence(csr_array(w), ids, embeddings)
    return Registration(evidence, gaussians.fingerprint, EncoderIdentity("drawn", DIM)).to_field()


class Most:
    """The most memory of this process, looked at a hundred times a second. GiB."""

    def __enter__(self) -> "Most":
        self.start, self.most, self.running = resident(), 0.0, True
        self.thread = threading.Thread(target=self._watch)
        self.thread.start()
        return self

    def _watch(self) -> None:
        while self.running:
            self.most = max(self.most, resident() - self.start)
            time.sleep(0.01)

    def __exit__(self, *_: object) -> None:
        self.running = False
        self.thread.join()


def resident() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 2**30


def main() -> None:
    given = arguments(__doc__, gaussians=[50_000, 200_000, 1_000_000], views=100, masks=300, threads=2)
    print("| Gaussians | masks | weights | forest s | CPU s | all s | CPU s | GiB beside W | objects |")
    print("|---|---|---|---|---|---|---|---|---|")
    for count in given.gaussians:
        gaussians = room(count)
        field = registered(gaussians, given.views, given.masks)
        assert field.evidence is not None
        start, cpu = time.perf_counter(), time.process_time()
        forest = grow(field.evidence, gaussians.means[field.gaussian_ids], threads=given.threads)
        choose(forest, np.arange(len(field)), MIN_GAUSSIANS)
        grown, grown_cpu = time.perf_counter() - start, time.process_time() - cpu
        start, cpu = time.perf_counter(), time.process_time()
        with Most() as memory:
            objects = find_objects(field, gaussians, threads=given.threads)
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        weights = field.evidence.weights
        print(
            f"| {count:,} | {weights.shape[1]:,} | {weights.nnz:,} | {grown:.1f} | {grown_cpu:.1f} | {seconds:.1f} | "
            f"{cpu:.1f} | {memory.most:.2f} | {len(objects):,} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
