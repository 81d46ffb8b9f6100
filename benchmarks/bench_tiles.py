"""A street of rooms, registered in tiles: time and memory against views, blocks and Gaussians, up to a city's block.

    drsplat demo --output demo
    python benchmarks/bench_tiles.py demo [--rooms 4 8 16 30] [--views 50] [--side 160] [--workers 1] [--check]
    python benchmarks/bench_tiles.py demo --rooms 30 --views 400     # a city's block: 3 million Gaussians, 12,000 views

The demo's room (100,000 Gaussians) is repeated along a road, each copy with its photos from slightly other places; a
block of 30 rooms has 3 million Gaussians. views: of each room. side: pixels of a photo's longer side. CPU time is of
all processes; memory is what they held together, looked at every 20 ms: the most of their own, and the most with the
pages of files that they had mapped. --most GB is a limit of the system on the former (RLIMIT_DATA), beyond which
memory is refused. --check compares the field with that of one registration of the whole, to the bit (in the memory that
this takes). --objects finds the objects of the field, and says what that takes.
"""

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from costs import Watching, family

import drsplat as ds
from drsplat.field.codes import Smaller
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.finding import find_objects
from drsplat.field.tiles.launching import OneProcess, Processes
from drsplat.field.tiles.registering import register_tiles
from drsplat.formats.sources import Block, sources_of
from drsplat.formats.tiles import Tiles, read_tiles
from drsplat.scene.masks.features import ViewFeatures
from drsplat.scene.similarity import Similarity

JITTER = 0.05  # scene units by which cameras of one photo are apart


@dataclass(frozen=True, eq=False)
class Repeated(Mapping[str, ViewFeatures]):
    """The features of the room's photos, by the names of the street's views."""

    folder: Mapping[str, ViewFeatures]
    keys_of: dict[str, str]

    @property
    def encoder(self) -> object:
        return getattr(self.folder, "encoder", None)

    def __getitem__(self, name: str) -> ViewFeatures:
        return self.folder[self.keys_of[name]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys_of)

    def __len__(self) -> int:
        return len(self.keys_of)


def step_of(room: ds.Gaussians) -> float:
    """From a room to the next one."""
    return float(np.quantile(room.means[:, 0], 0.999) - np.quantile(room.means[:, 0], 0.001))


def street(room: ds.Gaussians, folder: Path, scene: Path, rooms: int) -> Tiles:
    (source,) = sources_of(scene)
    step = np.array([step_of(room), 0, 0])
    return cut([Block(source, Similarity(1.0, np.eye(3), k * step)) for k in range(rooms)], folder / "street.tiles")


def walk(
    views: list[ds.View], rooms: int, per_room: int, step: float, side: int
) -> tuple[list[ds.View], dict[str, str]]:
    rng, walked, keys = np.random.default_rng(0), [], {}
    for k in range(rooms):
        for n in range(per_room):
            view = views[n % len(views)].limited(side)
            pose = view.cam_from_world.copy()
            eye = view.center + [k * step, 0, 0] + (JITTER * rng.normal(size=3) if n >= len(views) else 0)
            pose[:3, 3] = -pose[:3, :3] @ eye
            name = f"room{k:03d}_{n:04d}.jpg"
            walked.append(replace(view, name=name, cam_from_world=pose, image_path=None))
            keys[name.removesuffix(".jpg")] = Path(view.name).stem
    return walked, keys


def cpu() -> float:
    kinds = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(used.ru_utime + used.ru_stime for used in kinds)


def measured(
    given: argparse.Namespace, room: ds.Gaussians, views: list[ds.View], rooms: int, place: Path
) -> tuple[object, ...]:
    scene, folder = given.demo / "scene.compressed.ply", ds.read_features(given.demo / "language_features")
    memory, start = Watching(lambda: family(os.getpid())), time.perf_counter()
    tiles = street(room, place, scene, rooms)
    cut_s = time.perf_counter() - start
    walked, keys = walk(views, rooms, given.views, step_of(room), given.side)
    features = Repeated(folder, keys)
    start, before = time.perf_counter(), cpu()
    launcher = Processes(given.workers) if given.workers > 1 else OneProcess()
    parts, threads = place / "parts", 2 // given.workers
    made = register_tiles(tiles, walked, features, parts=parts, launcher=launcher, threads=threads)
    columns_s, used = time.perf_counter() - start, cpu() - before
    start = time.perf_counter()
    made.to_field(Smaller()).save(place / "street.field")
    field_s = time.perf_counter() - start
    disk = sum(file.stat().st_size for file in place.rglob("*") if file.is_file()) / 2**30
    held = f"{memory.own / 2**30:.2f}", f"{memory.whole / 2**30:.2f}"
    if given.objects:
        with ProcessPoolExecutor(1, get_context("spawn")) as fresh:  # as `drsplat objects` is a command of its own
            print(
                fresh.submit(objects_of, place / "street.field", tiles.path, parts, given.workers).result(), flush=True
            )
    same = ""
    if given.check:
        whole = ds.register(tiles.gaussians(), walked, features).to_field(Smaller())
        same = str(whole.equals(ds.load_field(place / "street.field")))
    return (
        rooms, f"{len(tiles):,}", f"{len(walked):,}", f"{cut_s:.0f}", f"{columns_s:.0f}",
        f"{1000 * used / len(walked):.0f}", f"{field_s:.0f}", f"{made.weights.nnz:,}", f"{disk:.2f}", *held, same,
    )  # fmt: skip


def objects_of(path: Path, tiles: Path, parts: Path, workers: int) -> str:
    """What finding the objects takes."""
    memory, start = Watching(lambda: family(os.getpid())), cpu()
    field, launcher = ds.load_field(path), Processes(workers) if workers > 1 else OneProcess()
    found = find_objects(field, read_tiles(tiles), parts=str(parts), launcher=launcher, threads=2 // workers)
    spent, own, whole = cpu() - start, memory.own / 2**30, memory.whole / 2**30
    weights = field.evidence.weights.nnz if field.evidence else 0
    return (
        f"{len(found)} objects of {len(field):,} Gaussians with {weights:,} weights: {spent:.0f} s of processor, "
        f"{own:.2f} GiB own, {whole:.2f} with maps"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("--rooms", type=int, nargs="+", default=[4, 8, 16, 30])
    parser.add_argument("--views", type=int, default=50)
    parser.add_argument("--side", type=int, default=160)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--most", type=float)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--objects", action="store_true")
    given = parser.parse_args()
    if given.most:
        resource.setrlimit(resource.RLIMIT_DATA, (int(given.most * 1e9),) * 2)
    room, folder = ds.read_gaussians(given.demo / "scene.compressed.ply"), given.demo / "language_features"
    views = [view for view in ds.read_views(given.demo) if view.name in ds.read_features(folder)]
    heads = (
        "rooms",
        "Gaussians",
        "views",
        "cut s",
        "columns s",
        "CPU ms a view",
        "field s",
        "W",
        "GiB on disk",
        "GiB own",
    )
    print("|".join(("", *heads, "with maps", "same bits", "")))
    print("|---" * (len(heads) + 2) + "|")
    for rooms in given.rooms:
        with tempfile.TemporaryDirectory(prefix="street-") as place:
            made = measured(given, room, views, rooms, Path(place))
        print("|".join(("", *map(str, made), "")), flush=True)


if __name__ == "__main__":
    main()
