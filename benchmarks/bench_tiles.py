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

The second table is computed, not measured: what 1 to 64 nodes of 16 cores would take for as many such streets, if each
task took what it took here, and a store delivered and took so many bytes a second in all. One node learns the code from
64 views, however many there are, and puts the field together.
"""

import argparse
import heapq
import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from costs import Watching, family

import drsplat as ds
from drsplat.field.codes import Smaller
from drsplat.field.learning import learn
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.finding import find_objects
from drsplat.field.tiles.launching import OneProcess, Processes
from drsplat.field.tiles.registering import register_tiles
from drsplat.field.tiles.seeing import seen_tiles
from drsplat.formats.sources import Block, sources_of
from drsplat.formats.tiles import Tiles, read_tiles
from drsplat.scene.masks.features import ViewFeatures
from drsplat.scene.similarity import Similarity

BYTES = 44  # of a Gaussian's shape
CORES = 16  # of a node
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


class Clocked:
    """A function, with the CPU seconds that it takes."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.seconds = function, 0.0

    def __call__(self, *given: Any) -> Any:
        start = time.process_time()
        result = self.function(*given)
        self.seconds += time.process_time() - start
        return result


class Timed:
    """In this process, with the CPU seconds of each task."""

    def __init__(self) -> None:
        self.seconds: list[list[float]] = []  # of each kind of task

    def results(self, work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        self.seconds.append([])
        for item in items:
            start = time.process_time()
            result = work(item)
            self.seconds[-1].append(time.process_time() - start)
            yield result


def makespan(seconds: Sequence[float], workers: int) -> float:
    """Of tasks in their order, each on the worker that is free first."""
    free = [0.0] * workers
    for task in seconds:
        heapq.heapreplace(free, free[0] + task)
    return max(free)


def weak_scaling(made: "Street") -> None:
    """As many streets as nodes, one scene."""
    heads = "nodes", "columns s", "rows s", "codes s", "one node s", "store at 1 GB/s: s", "at 10 GB/s: s", "in all s"
    print("\n" + "|".join(("", *heads, "")))
    print("|---" * len(heads) + "|")
    for nodes in (1, 2, 4, 8, 16, 32, 64):
        columns, rows, *codes = (makespan(kind * nodes, CORES * nodes) for kind in made.kinds)
        slow, quick = made.moved * nodes / 1e9, made.moved * nodes / 1e10
        one = made.learn_s + made.rest_s * nodes
        whole = max(columns + rows + sum(codes), quick) + one
        seconds = (f"{value:.1f}" for value in (columns, rows, sum(codes), one, slow, quick, whole))
        print("|".join(("", str(nodes), *seconds, "")))


def cpu() -> float:
    kinds = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(used.ru_utime + used.ru_stime for used in kinds)


class Street(NamedTuple):
    """What registering a street took. kinds: CPU seconds of each kind of task. learn_s: of learning the code, which
    no more views make longer; rest_s: of what else one process does. moved: bytes that tasks read and write.
    """

    numbers: tuple[object, ...]
    kinds: list[list[float]]
    learn_s: float
    rest_s: float
    moved: float


def measured(given: argparse.Namespace, room: ds.Gaussians, views: list[ds.View], rooms: int, place: Path) -> Street:
    scene, folder = given.demo / "scene.compressed.ply", ds.read_features(given.demo / "language_features")
    memory, start = Watching(lambda: family(os.getpid())), time.perf_counter()
    tiles = street(room, place, scene, rooms)
    cut_s = time.perf_counter() - start
    walked, keys = walk(views, rooms, given.views, step_of(room), given.side)
    features = Repeated(folder, keys)
    start, before = time.perf_counter(), cpu()
    launcher = Processes(given.workers) if given.workers > 1 else Timed()
    parts, threads = place / "parts", 2 // given.workers
    made = register_tiles(tiles, walked, features, parts=parts, launcher=launcher, threads=threads)
    columns_s, used = time.perf_counter() - start, cpu() - before
    start, code_cpu, learning = time.perf_counter(), time.process_time(), Clocked(learn)
    with patch("drsplat.field.building.learn", learning):
        made.to_field(Smaller()).save(place / "street.field")
    field_s, code_cpu = time.perf_counter() - start, time.process_time() - code_cpu
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
    numbers = (
        rooms, f"{len(tiles):,}", f"{len(walked):,}", f"{cut_s:.0f}", f"{columns_s:.0f}",
        f"{1000 * used / len(walked):.0f}", f"{field_s:.0f}", f"{made.weights.nnz:,}", f"{disk:.2f}", *held, same,
    )  # fmt: skip
    sizes = np.array([tile.num_rows for tile in tiles.tiles]) * BYTES
    read = sum(float(sizes[seen_tiles(tiles, view, tiles.near)].sum()) for view in walked[::20]) * 20
    written = sum(file.stat().st_size for file in parts.rglob("*.safetensors"))
    kinds = launcher.seconds if isinstance(launcher, Timed) else []
    rest = code_cpu - learning.seconds - sum(map(sum, kinds[2:]))
    return Street(numbers, kinds, learning.seconds, rest, read + 2 * written)


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
        print("|".join(("", *map(str, made.numbers), "")), flush=True)
    if made.kinds:
        weak_scaling(made)


if __name__ == "__main__":
    main()
