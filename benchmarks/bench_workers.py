"""Objects of a street in blocks: the time by number of workers, and how like the true things they are.

    python benchmarks/bench_city.py DEMO FOLDER --rooms 12                     # makes FOLDER/street12
    python benchmarks/bench_workers.py DEMO FOLDER/street12 [--most 600000] [--check 2] [--truth]

most: weights of a block. Tasks are done one after another in this process, with the processor's seconds of each. The
second table is computed of them: the seconds of so many workers, each kind of task after the one before, each task on
the worker that is free first; what is no task stays one process. --check: as many processes find them too, and say
whether all arrays have the same bits. --truth: AP of things, and of how many true things of the rooms (demo/truth.json,
60 Gaussians or more) some object has an IoU of half or more, in blocks and of the whole.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bench_tiles import makespan

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import drsplat as ds
from benchmarks.suite.instances import Region, compare, numbers
from benchmarks.suite.scenes import owners
from drsplat.field.forest import Objects
from drsplat.field.objects import finding
from drsplat.field.tiles import finding as in_tiles
from drsplat.field.tiles.launching import Processes
from drsplat.formats.tiles import Tiles, read_tiles

WORKERS = (1, 2, 4, 8, 16, 32)


class Timed:
    """In this process, with the CPU seconds of each task, by kind."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    def results(self, work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        kind = type(getattr(work, "part", work)).__name__
        for item in items:
            start = time.process_time()
            result = work(item)
            self.seconds.setdefault(kind, []).append(time.process_time() - start)
            yield result


def found(field: ds.LanguageField, tiles: Tiles, launcher: Any) -> Objects:
    with tempfile.TemporaryDirectory(prefix="workers-") as parts:
        return in_tiles.find_objects(field, tiles, parts=parts, launcher=launcher, threads=1)


def true_things(demo: Path, tiles: Tiles) -> tuple[np.ndarray, list[int]]:
    """Return the number of each Gaussian's true thing, another one in each room, and the numbers of all things."""
    truth, room = json.loads((demo / "truth.json").read_text()), ds.read_gaussians(demo / "scene.compressed.ply")
    count = len(truth["objects"]) + len(truth["structures"])
    of_room, extra = owners(demo, room, ds.read_views(demo), count), tiles.gaussians().extra
    blocks, of = extra["block"].astype(np.int64), of_room[extra["source_row"].astype(np.int64)]
    things = [block * count + thing["id"] for block in range(int(blocks.max()) + 1) for thing in truth["objects"]]
    return np.where(of >= 0, blocks * count + of, -1), things


def print_truth(name: str, field: ds.LanguageField, objects: Objects, truth: tuple[np.ndarray, list[int]]) -> None:
    of = objects.thing_of()
    regions = [
        Region(field.gaussian_ids[of == number].astype(np.int64), float(objects.sure[node]))
        for number, node in enumerate(objects.things.tolist())
    ]
    scores = numbers(compare(regions, *truth))
    told = " | ".join(f"{scores[key]:.3f}" for key in ("AP", "AP50", "PQ", "found"))
    print(f"| {name} | {len(objects)} | {told} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("street", type=Path)
    parser.add_argument("--most", type=int, default=600_000)
    parser.add_argument("--check", type=int, default=0)
    parser.add_argument("--truth", action="store_true")
    given = parser.parse_args()
    field, tiles = ds.load_field(given.street / "street.field"), read_tiles(given.street / "street.tiles")
    usual, finding.MAX_WEIGHTS, finding.BLOCK_WEIGHTS = finding.MAX_WEIGHTS, 0, given.most
    timed, start = Timed(), time.process_time()
    objects = found(field, tiles, timed)
    spent = time.process_time() - start
    alone = spent - sum(map(sum, timed.seconds.values()))
    print("| tasks | | CPU s | longest |\n|---|--:|--:|--:|")
    for kind, seconds in timed.seconds.items():
        print(f"| {kind} | {len(seconds)} | {sum(seconds):.2f} | {max(seconds):.2f} |")
    print(f"| none | | {alone:.2f} | |\n\n| workers | s | times as fast |\n|--:|--:|--:|")
    for workers in WORKERS:
        clock = alone + sum(makespan(seconds, workers) for seconds in timed.seconds.values())
        print(f"| {workers} | {clock:.1f} | {spent / clock:.1f} |", flush=True)
    if given.check:
        others = found(field, tiles, Processes(given.check)).tensors()
        same = all(np.array_equal(array, others[name]) for name, array in objects.tensors().items())
        print(f"\n{given.check} processes: same bits {same}")
    if given.truth:
        truth = true_things(given.demo, tiles)
        print("\n| | objects | AP | AP50 | PQ | found |\n|---|--:|--:|--:|--:|--:|")
        print_truth("in blocks", field, objects, truth)
        finding.MAX_WEIGHTS = usual
        print_truth("the whole", field, found(field, tiles, timed), truth)


if __name__ == "__main__":
    main()
