"""Pseudo labels of Gaussians: seconds and peak memory.

    python benchmarks/bench_pseudo_labels.py [--gaussians 1000000] [--points 1000000] [--threads 0]

A room with furniture: points lie evenly on its surfaces, Gaussians are discs near them whose sizes are
spread as in trained scenes (half of them within a factor of two of 1.5 cm), some of them metres wide.
"""

import resource
import time

import numpy as np
from machine import arguments

from drsplat import Gaussians
from drsplat.evaluation.pseudo_labels import LabelledPoints, density_labels, printed_labels, pseudo_labels

ROOM = np.array([8.0, 6.0, 3.0])
HUGE_SHARE = 0.002


def boxes(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 2, 3): low and high corners; the room first."""
    size = rng.uniform(0.1, 1.2, (count, 3))
    low = rng.uniform(0, 1, (count, 3)) * (ROOM - size)
    low[:, 2] = 0
    low[0], size[0] = 0, ROOM
    return np.stack([low, low + size], 1)


def on_surfaces(rng: np.random.Generator, corners: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """Positions, the axis of their normals and the number of their box."""
    size = corners[:, 1] - corners[:, 0]
    area = np.stack([size[:, 1] * size[:, 2], size[:, 0] * size[:, 2], size[:, 0] * size[:, 1]], 1)
    face = rng.choice(area.size, count, p=area.ravel() / area.sum())
    box, axis = face // 3, face % 3
    positions = corners[box, 0] + rng.random((count, 3)) * size[box]
    side = rng.integers(0, 2, count)
    positions[np.arange(count), axis] = corners[box, side, axis]
    return positions, axis, box


def discs(rng: np.random.Generator, corners: np.ndarray, count: int) -> Gaussians:
    positions, axis, _ = on_surfaces(rng, corners, count)
    positions += rng.normal(0, 0.002, positions.shape)
    scales = 0.015 * np.exp(rng.normal(0, 1.0, (count, 1)) + rng.normal(0, 0.4, (count, 3)))
    scales[rng.random(count) < HUGE_SHARE] *= 30
    scales[np.arange(count), axis] *= 0.2
    half = rng.normal(0, 0.05, (count, 3))  # nearly along the surface
    quats = np.concatenate([np.ones((count, 1)), half], 1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    columns = (positions, quats, scales, rng.random(count), np.zeros((count, 1, 3)))
    return Gaussians(*(column.astype(np.float32) for column in columns))


def main() -> None:
    args = arguments(__doc__, gaussians=1_000_000, points=1_000_000, threads=0)
    rng = np.random.default_rng(0)
    corners = boxes(rng, 40)
    positions, _, box = on_surfaces(rng, corners, args.points)
    points = LabelledPoints(positions.astype(np.float32), (box % 20).astype(np.int32))
    gaussians = discs(rng, corners, args.gaussians)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{args.gaussians:,} Gaussians, {args.points:,} points, {args.threads or 'all'} threads")
    for name, run in (
        ("density vote", lambda: density_labels(gaussians, points, threads=args.threads)),
        ("and the nearest", lambda: pseudo_labels(gaussians, points, threads=args.threads)),
        ("Eq. 2 as printed", lambda: printed_labels(gaussians, points)),
    ):
        start = time.perf_counter()
        labels = run()
        seconds = time.perf_counter() - start
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"{name:<18} {seconds:6.1f} s, peak {peak:.2f} GiB ({before:.2f} before), "
            f"{(labels < 0).mean():.1%} without a label"
        )


if __name__ == "__main__":
    main()
