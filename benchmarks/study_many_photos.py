"""What thousands of photos cost `drsplat capture` before COLMAP matches them: time and memory of bringing and pairing.

    python benchmarks/study_many_photos.py [--photos 10000]

Photos are small and made up; so are their features, which are written into COLMAP's database as they would be found.
Photos are numbered, as those of a walk. Each stage runs in a process of its own, whose greatest memory is told.
"""

import argparse
import json
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
from machine import describe
from PIL import Image

from drsplat.base.system import peak_memory_bytes
from drsplat.photos.capture import database as colmap_database
from drsplat.photos.capture.capturing import _bring_all
from drsplat.photos.capture.finding import find_photos
from drsplat.photos.capture.posing import Posing
from drsplat.photos.capture.work import Work

WIDTH, HEIGHT, FEATURES = 160, 120, 500
STAGES = ("bring", "pair")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--photos", type=int, default=10_000)
    parser.add_argument("--stage", choices=STAGES, help=argparse.SUPPRESS)
    parser.add_argument("--folder", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.stage:
        print(json.dumps({"bring": bring, "pair": pair}[arguments.stage](Path(arguments.folder))))
        return
    print(describe())
    print("stage     photos     pairs    seconds    memory, MB")
    with tempfile.TemporaryDirectory() as folder:
        make_photos(Path(folder, "photos"), arguments.photos)
        for stage in STAGES:
            line = [sys.executable, __file__, "--stage", stage, "--folder", folder]
            said = json.loads(subprocess.run(line, check=True, capture_output=True, text=True).stdout)
            print(
                f"{stage:8} {said['photos']:7,} {said['pairs']:9,} {said['seconds']:10.1f} "
                f"{said['memory_bytes'] / 1e6:13.0f}",
                flush=True,
            )


def make_photos(folder: Path, count: int) -> None:
    folder.mkdir()
    rng = np.random.default_rng(0)
    for index in range(count):
        blots = rng.integers(0, 255, (HEIGHT // 8, WIDTH // 8, 3), np.uint8)
        Image.fromarray(blots).resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC).save(folder / f"{index:06}.jpg")


def bring(folder: Path) -> dict[str, float]:
    begin = time.perf_counter()
    photos = _bring_all(find_photos(folder / "photos"), Work(folder / "capture"), _quiet)
    return _answer(begin, len(photos), 0)


def pair(folder: Path) -> dict[str, float]:
    work = Work(folder / "capture")
    photos = _bring_all(find_photos(folder / "photos"), work, _quiet)
    posing = Posing(work, photos, "radial", 1, _quiet)
    posing._camera_ids()
    write_features(posing._database, [photo.file for photo in photos])
    begin = time.perf_counter()
    with colmap_database.reading(posing._database) as database:
        features = colmap_database.num_features(database)
        pairs = posing._pairs(database, features)
    return _answer(begin, len(features), len(pairs))


def write_features(path: Path, names: list[str]) -> None:
    """Write random descriptors, in which photos that follow each other share some."""
    rng = np.random.default_rng(0)
    with closing(sqlite3.connect(path)) as database, database:
        columns = [row[1] for row in database.execute("PRAGMA table_info(descriptors)")]
        keypoints = np.zeros((FEATURES, 2), np.float32).tobytes()
        shared = rng.integers(0, 80, (FEATURES, 128), np.uint8)
        for index, name in enumerate(names, 1):
            shared[rng.integers(0, FEATURES, 40)] = rng.integers(0, 80, (40, 128), np.uint8)
            database.execute("INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, 1)", (index, name))
            database.execute("INSERT INTO keypoints (image_id, rows, cols, data) VALUES (?, ?, 2, ?)",
                             (index, FEATURES, keypoints))  # fmt: skip
            row = {"image_id": index, "rows": FEATURES, "cols": 128, "data": shared.tobytes(), "type": 0}
            given = [column for column in columns if column in row]
            database.execute(
                f"INSERT INTO descriptors ({', '.join(given)}) VALUES ({', '.join('?' * len(given))})",
                [row[column] for column in given],
            )


def _answer(begin: float, photos: int, pairs: int) -> dict[str, float]:
    seconds = time.perf_counter() - begin
    return {"photos": photos, "pairs": pairs, "seconds": seconds, "memory_bytes": peak_memory_bytes()}


def _quiet(stage: str, done: int, total: int) -> None:
    """Show no progress."""


if __name__ == "__main__":
    main()
