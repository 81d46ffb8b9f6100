"""How fast films are made: pictures a second of an orbit with an answer in it, and what of that each step takes.

    python benchmarks/bench_films.py [--gaussians 100000] [--frames 60] [--width 640] [--height 480] [--threads 0]

A ball of random Gaussians with harmonics of degree 1, of which a tenth is the answer; all formats in turn. Seconds are
those of the wall and of all processors together (ffmpeg's are not in the latter).
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from machine import arguments

from drsplat.authoring.filming.encoding import SUFFIXES as ENCODED
from drsplat.authoring.filming.encoding import ffmpeg
from drsplat.authoring.filming.frames import Film, Highlight, marks_of
from drsplat.authoring.filming.planning import around_scene, orbit
from drsplat.authoring.filming.writing import SUFFIXES, write_film
from drsplat.kernels.boxes import box_of
from drsplat.query import Match
from drsplat.scene.gaussians import Gaussians

UP = np.array([0.0, 0.0, 1.0])


def ball(count: int) -> Gaussians:
    """Small, fairly solid Gaussians, nearer to each other in the middle."""
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(count, 4))
    columns = (
        rng.normal(size=(count, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.exp(rng.normal(-4.0, 0.5, (count, 3))),
        rng.uniform(0.2, 1.0, count),
        rng.normal(0, 0.5, (count, 4, 3)),
    )
    return Gaussians(*(column.astype(np.float32) for column in columns))


def answer_of(scene: Gaussians) -> Highlight:
    """The Gaussians of a tenth that lie together."""
    ids = np.sort(np.argsort(np.linalg.norm(scene.means - (1.0, 0.0, 0.0), axis=1))[: len(scene) // 10])
    values = np.zeros((len(scene), 1), np.float32)
    values[ids] = 1
    match = Match(*box_of(scene, ids, UP), 1.0, ids)
    return Highlight([match], values, False, marks_of([match], "red mug"))


def counted(film: Film, spent: list[float]) -> Iterator[np.ndarray]:
    """The pictures, and how long each took to be made."""
    pictures = film.pictures()
    while True:
        start = time.perf_counter()
        picture = next(pictures, None)
        if picture is None:
            return
        spent.append(time.perf_counter() - start)
        yield picture


def main() -> None:
    given = arguments(__doc__, gaussians=100_000, frames=60, width=640, height=480, threads=0)
    scene = ball(given.gaussians)
    views = orbit(around_scene(scene, (), UP), UP).views(given.frames, (given.width, given.height))
    print(f"{given.gaussians:,} Gaussians, {given.frames} pictures of {given.width}x{given.height}")
    for suffix in SUFFIXES:
        if suffix in ENCODED and ffmpeg() is None:
            print(f"{suffix}: ffmpeg is not here")
            continue
        spent: list[float] = []
        film = Film(scene, views, 30.0, answer_of(scene), threads=given.threads)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"film{suffix}"
            wall, own = time.perf_counter(), time.process_time()
            write_film(path, counted(film, spent), 30.0)
            wall, own = time.perf_counter() - wall, time.process_time() - own
            size = path.stat().st_size
        print(
            f"{suffix}: {given.frames / wall:.1f} pictures a second, {1000 * np.median(spent):.0f} ms to make one "
            f"(slowest {1000 * max(spent):.0f}), {1000 * (wall - sum(spent)) / given.frames:.0f} ms to hand it on; "
            f"processor {1000 * own / given.frames:.0f} ms; {size / 1e6:.1f} MB"
        )


if __name__ == "__main__":
    main()
