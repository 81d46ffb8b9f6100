"""What a query of a tiled scene takes: memory and time of `drsplat locate` and of opening, against Gaussians.

    drsplat demo --output-dir demo
    python benchmarks/bench_city.py demo FOLDER [--rooms 4 8 15 30] [--views 20] [--side 80] [--ask "red vase"]

--serve asks `drsplat serve` instead, one worker on one thread, and says what each answer took and what all its
processes hold after it.

Makes streets of the demo's room as bench_tiles.py does, with their fields and objects, and keeps them in FOLDER, where
a second run finds them. Each command is a process of its own, looked at every 5 ms: the most that it held of its own
(anonymous), and with the pages of files that it had mapped.
"""

import argparse
import json
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np
from bench_tiles import Repeated, step_of, street, walk
from costs import cost_of, family, held, seconds_of

import drsplat as ds
from drsplat.field.codes import Smaller
from drsplat.field.objects.finding import find_objects
from drsplat.field.tiles.registering import register_tiles
from drsplat.formats.colmap_binary import write_colmap
from drsplat.formats.tiles import read_tiles

SERVED: list[tuple[str, dict[str, object] | None]] = [
    ("", None), ("/{}", None), ("/{}/select", {"text": "red vase"}), ("/{}/locate", {"text": "red vase"}),
    ("/{}/locate", {"text": "candle"}), ("/{}/objects", None), ("/{}/what-is", {"point": [-0.14, 0.21, 0.79]}),
    ("/{}/picture", {"text": "candle"}), ("/{}/picture", {"text": "candle"}),
]  # fmt: skip


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


def serve(place: Path) -> None:
    """Ask a served street, and print what each answer took."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "drsplat", "serve", str(place), "--port", str(port), "--workers", "1"]
    service = subprocess.Popen([*command, "--threads", "1"], stdout=subprocess.DEVNULL)
    try:
        for _ in range(600):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        print("|asked|CPU s|MiB own|with maps|\n|---|--:|--:|--:|")
        for path, body in SERVED:
            before = seconds_of(family(service.pid))
            where = f"http://127.0.0.1:{port}/scenes{path.format(place.name)}"
            data = None if body is None else json.dumps(body).encode()
            urlopen(Request(where, data, {"content-type": "application/json"}), timeout=60).read()
            pids = family(service.pid)
            spent = seconds_of(pids) - before
            own, whole = (sum(part) >> 20 for part in zip(*map(held, pids), strict=True))
            print(f"|{path} {body or ''}|{spent:.1f}|{own}|{whole}|", flush=True)
    finally:
        service.terminate()
        service.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rooms", type=int, nargs="+", default=[4, 8, 15, 30])
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--side", type=int, default=80)
    parser.add_argument("--ask", default="red vase")
    parser.add_argument("--serve", action="store_true")
    given = parser.parse_args()
    print("|rooms|Gaussians|matches|CPU s|MiB own|with maps|\n|--:|--:|--:|--:|--:|--:|")
    for rooms in given.rooms:
        place = given.folder / f"street{rooms}"
        if not (place / "street.field").exists():
            make(given.demo, place, rooms, given.views, given.side)
        if given.serve:
            serve(place)
            continue
        command = [sys.executable, "-m", "drsplat", "locate", str(place / "street.field"), given.ask, "--json"]
        cost = cost_of([*command, "--scene", str(place / "street.tiles")])
        matches = json.loads(cost.output)["num_matches"]
        count = len(read_tiles(place / "street.tiles"))
        print(f"|{rooms}|{count:,}|{matches}|{cost.cpu_s:.1f}|{cost.own >> 20:,}|{cost.whole >> 20:,}|", flush=True)


if __name__ == "__main__":
    main()
