"""All methods on all scenes, one file per scene, masks and method, so that a killed run goes on."""

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from drsplat import MiniEncoder
from drsplat.formats.replacing import replacing
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.encoders import identity_json

from . import stamps
from .aggregators import MEASURED
from .methods import OBJECTS, Workshop
from .rendered import STEPS
from .rivals import FITTED
from .scenes import BenchScene, about, read_scene
from .scoring import SWEEP, scored

VERSION = 2
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
METHODS = (*MEASURED, OBJECTS, *STEPS)
ALL = (*METHODS, *FITTED)


@dataclass(frozen=True)
class Task:
    """One scene and one kind of masks. every: takes one in so many of the views.

    efforts: by rival the share of its paper's steps, all of them by default. device: of PyTorch, that rivals are
    fitted on.
    """

    folder: Path
    masks: str
    methods: tuple[str, ...]
    work: Path
    every: int
    threads: int
    efforts: Mapping[str, float] = field(default_factory=dict)
    device: str = "cpu"


def run(tasks: Sequence[Task], jobs: int) -> list[dict[str, Any]]:
    """The records of all tasks, in their order."""
    for variable in THREADS:  # read when workers start
        os.environ.setdefault(variable, str(threads_for(jobs)))
    if jobs == 1:
        return [record for task in tasks for record in run_task(task)]
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        return [record for records in pool.map(run_task, tasks) for record in records]


def run_task(task: Task) -> list[dict[str, Any]]:
    """Those that are on disk already and are of the same inputs are not made again."""
    scene, encoder = read_scene(task.folder, task.every), MiniEncoder()
    key = _key(scene, task, encoder)
    found = {method: _finished(_path(task, method), _for(method, key, task)) for method in task.methods}
    missing = [method for method, record in found.items() if record is None]
    found.update(_made(task, scene, encoder, missing))
    return [dict(record) for record in found.values() if record is not None]


def _made(
    task: Task, scene: BenchScene, encoder: MiniEncoder, methods: Sequence[str]
) -> Iterator[tuple[str, dict[str, Any]]]:
    if not methods:
        return
    key, start = _key(scene, task, encoder), time.perf_counter()
    workshop = Workshop(scene, task.masks, encoder, task.threads, task.efforts, task.device)
    print(f"{scene.name}, {task.masks}: {workshop.num_masks} masks", flush=True)
    for method in methods:
        numbers, seconds = scored(scene, workshop.methods(method), task.threads)
        seconds["all"] = time.perf_counter() - start
        start = time.perf_counter()
        record: dict[str, Any] = {"scene": scene.name, "masks": task.masks, "method": method}
        record |= {"num_masks": workshop.num_masks, **numbers}
        if method in FITTED:
            record["effort"] = task.efforts.get(method, 1.0)
        record |= {"code": code_of(method), "seconds": round(seconds["all"], 1)}
        document = {"key": _for(method, key, task), "seconds": seconds, "record": record}
        with replacing(_path(task, method), overwrite=True) as file:
            file.write(json.dumps(document, indent=1).encode() + b"\n")
        print(f"{scene.name}, {task.masks}, {method}: {seconds['all']:.1f} s", flush=True)
        yield method, record


def _path(task: Task, method: str) -> Path:
    place = task.work / task.folder.resolve().name / task.masks
    place.mkdir(parents=True, exist_ok=True)
    return place / f"{method}.json"


def _finished(path: Path, key: dict[str, Any]) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    document = json.loads(path.read_text(encoding="utf-8"))
    record: dict[str, Any] = document["record"]
    return record if document["key"] == key else None


def _key(scene: BenchScene, task: Task, encoder: MiniEncoder) -> dict[str, Any]:
    """What decides a record beside its code, which `_for` adds."""
    known: dict[str, Any] = {
        "version": VERSION,
        "scene": about(scene),
        "encoder": {**identity_json(encoder.identity), "threshold": encoder.threshold},
        "segmenter": dict(GraphSegmenter().identity) if task.masks == "graph" else None,
        "sweep": list(SWEEP),
        "every": task.every,
    }
    copied: dict[str, Any] = json.loads(json.dumps(known))
    return copied


def _for(method: str, key: dict[str, Any], task: Task) -> dict[str, Any]:
    fitted = {"effort": task.efforts.get(method, 1.0)} if method in FITTED else {}
    return key | {"code": code_of(method)} | fitted


def code_of(method: str) -> str:
    """Return the stamp of the code that decides the numbers of a method."""
    if method in FITTED:
        return stamps.stamp(stamps.FITTED)
    if method in STEPS:
        return stamps.stamp(stamps.RENDERED)
    return stamps.stamp(stamps.METHODS)


def threads_for(jobs: int) -> int:
    return max(1, len(os.sched_getaffinity(0)) // jobs)
