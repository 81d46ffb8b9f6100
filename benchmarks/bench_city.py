"""What a query of a tiled scene takes: memory and time of `drsplat locate` and of opening, against Gaussians.

    drsplat demo --output-dir demo
    python benchmarks/bench_city.py demo FOLDER [--rooms 4 8 15 30] [--views 20] [--side 80] [--ask "red vase"]

Makes streets of the demo's room as bench_tiles.py does, with their fields and objects, and keeps them in FOLDER, where
a second run finds them. Each command is a process of its own, looked at every 5 ms: the most that it held of its own
(anonymous), and with the pages of files that it had mapped.
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench_tiles import Repeated, _held, step_of, street, walk

import drsplat as ds
from drsplat.field.codes import Smaller
from drsplat.field.objects.finding import find_objects
from drsplat.field.tiles.registering import register_tiles
from drsplat.formats.colmap_writing import write_colmap
from drsplat.formats.tiles import read_tiles


class Cost(NamedTuple):
    """What a process took. own, whole: bytes at most, without and with the pages of mapped files."""

    cpu_s: float
    own: int
    whole: int
    output: str


def make(demo: Path, place: Path, rooms: int, per_room: int, side: int) -> None:
    """Write a street with its cameras, its field and its objects."""
    room, features = ds.read_gaussians(demo / "scene.compressed.ply"), ds.read_features(demo / "language_features")
    views = [view for view in ds.read_views(demo) if view.name in features]
    place.mkdir(parents=True)
    tiles = street(room, place, demo / "scene.compressed.ply", rooms)
    walked, keys = walk(views, rooms, per_room, step_of(room), side)
    made = register_tiles(tiles, walked, Repeated(features, keys), parts=place / "parts", threads=1)
    field = made.to_field(Smaller())
    field.with_objects(find_objects(field, ds.read_gaussians(tiles.path))).save(place / "street.field")
    shutil.rmtree(place / "parts")
    (place / "sparse").mkdir()
    write_colmap(place / "sparse", walked, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


def cost_of(command: Sequence[str]) -> Cost:
    """Run a command and look at its memory until it ends."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    own = whole = 0
    while process.poll() is None:
        held = _held(process.pid)
        own, whole = max(own, held[0]), max(whole, held[1])
        time.sleep(0.005)
    output, errors = process.communicate()
    if process.returncode:
        raise SystemExit(errors)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Cost(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, own, whole, output)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rooms", type=int, nargs="+", default=[4, 8, 15, 30])
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--side", type=int, default=80)
    parser.add_argument("--ask", default="red vase")
    given = parser.parse_args()
    print("|rooms|Gaussians|matches|CPU s|MiB own|with maps|\n|--:|--:|--:|--:|--:|--:|")
    for rooms in given.rooms:
        place = given.folder / f"street{rooms}"
        if not (place / "street.field").exists():
            make(given.demo, place, rooms, given.views, given.side)
        command = [sys.executable, "-m", "drsplat", "locate", str(place / "street.field"), given.ask, "--json"]
        cost = cost_of([*command, "--scene", str(place / "street.tiles")])
        matches = json.loads(cost.output)["num_matches"]
        count = len(read_tiles(place / "street.tiles"))
        print(f"|{rooms}|{count:,}|{matches}|{cost.cpu_s:.1f}|{cost.own >> 20:,}|{cost.whole >> 20:,}|", flush=True)


if __name__ == "__main__":
    main()
