"""Answers to words in real captures and made rooms: the plain field, objects, and the best threshold, side by side.

Words and embeddings are drawn as `trials` says, of things that are known by `places`. IoU is over Gaussians, by the
weight that photos give them in which the truth is known. A place and its masks are a part that is kept once finished.
"""

import json
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drsplat.formats.replacing import replacing
from drsplat.formats.tensors import hash_file
from drsplat.query import Scene
from drsplat.query.defaults import MIN_GAUSSIANS

from . import places
from .outlines import outlines_path
from .scoring import rounded
from .stamps import ANSWERS as CODE
from .stamps import stamp
from .trials import Trial, trial
from .vocabularies import KINDS, Vocabulary

VERSION = 1
ROOM, CAPTURE = "room", "capture"
MASKS = {ROOM: ("graph", "true"), CAPTURE: ("graph", "sam")}
COLUMNS = ("plain", "objects", "best")
ASKED = ("plain", "objects")
SMALL = 0.01


class Answered(NamedTuple):
    """IoU of a word that something is called by: of the plain field, with objects, and at the best threshold of the
    plain field, chosen with the truth. missed: whether the first two find nothing. small: whether all that it means is
    less than SMALL of the Gaussians."""

    text: str
    plain: float
    objects: float
    best: float
    missed_plain: bool
    missed_objects: bool
    small: bool


@dataclass(frozen=True)
class Draws:
    """The trials of a place. wrong: percent of the masks with a wrong embedding, each in turn. seeds: of each."""

    wrong: tuple[int, ...] = (0, 20, 40)
    seeds: int = 2

    def of(self, place: places.Place, words: Vocabulary) -> Iterator[Trial]:
        for kind in KINDS:
            for share in self.wrong:
                for seed in range(self.seeds):
                    yield trial(place, words, kind, share / 100, seed)


def answered(case: Trial) -> Iterator[Answered]:
    """Ask for each word of a trial that something is called by."""
    scenes = case.scene(objects=False), case.scene(objects=True)
    for text, meant in case.present.items():
        plain, whole = (scene.ask(text) for scene in scenes)
        selected = [answer.values > answer.threshold for answer in (plain, whole)]
        ious = [case.iou(rows, meant) for rows in selected]
        missed = [bool(rows.sum() < MIN_GAUSSIANS) for rows in selected]
        best = best_iou(plain.values, meant, case.mass)
        yield Answered(text, ious[0], ious[1], best, missed[0], missed[1], bool(meant.mean() < SMALL))


def found_absent(case: Trial) -> list[tuple[bool, bool]]:
    """For each word that nothing is called by, whether the plain field and objects find something."""
    scenes = case.scene(objects=False), case.scene(objects=True)
    return [tuple(_finds(scene, text) for scene in scenes) for text in case.absent]  # type: ignore[misc]


def _finds(scene: Scene, text: str) -> bool:
    answer = scene.ask(text)
    return bool((answer.values > answer.threshold).sum() >= MIN_GAUSSIANS)


def best_iou(values: np.ndarray, meant: np.ndarray, mass: np.ndarray) -> float:
    """Return the highest IoU of all thresholds on the values."""
    return best_cut(values, meant, mass)[1]


def best_cut(values: np.ndarray, meant: np.ndarray, mass: np.ndarray) -> tuple[float, float]:
    """Return the lowest value that the best threshold selects, and the IoU. Equal values are selected together."""
    order = np.argsort(-values, kind="stable")
    hits, taken = np.cumsum((mass * meant)[order]), np.cumsum(mass[order])
    ious = hits / np.maximum(taken + (mass * meant).sum() - hits, 1e-9)
    last = np.flatnonzero(np.append(np.diff(values[order]) != 0, True))
    best = int(last[ious[last].argmax()])
    return float(values[order[best]]), float(ious[best])


def record_of(cases: Iterable[Trial]) -> dict[str, Any]:
    """Pool trials: lists of words and their IoUs, and shares of what was missed or found though absent."""
    asked: list[Answered] = []
    absent: list[tuple[bool, bool]] = []
    for case in cases:
        asked.extend(answered(case))
        absent.extend(found_absent(case))
    missed = [(one.missed_plain, one.missed_objects) for one in asked]
    record: dict[str, Any] = {"texts": [one.text for one in asked], "small": [one.small for one in asked]}
    record |= {column: [getattr(one, column) for one in asked] for column in COLUMNS}
    record |= {"missed": _shares(missed), "found": _shares(absent), "absent": len(absent)}
    return {key: rounded(value) for key, value in record.items()}


def _shares(pairs: Sequence[tuple[bool, bool]]) -> dict[str, float]:
    return {name: float(np.mean([pair[at] for pair in pairs])) for at, name in enumerate(ASKED)}


def place_of(given: str, kind: str, kept: Path) -> places.Place:
    """Return a packed room, or CAPTURE=SCENE, with one kind of masks."""
    folder, _, scene = given.partition("=")
    if not scene:
        return places.room(Path(folder), kind, kept)
    outlines = outlines_path(Path(folder).resolve().name)
    return places.capture(Path(folder), Path(scene), outlines if outlines.is_file() else None, kind, kept)


def kind_of(given: str) -> str:
    return CAPTURE if "=" in given else ROOM


def run(
    given: Sequence[str], words: Vocabulary, vectors: Path, kept: Path, draws: Draws, work: Path
) -> Iterator[dict[str, Any]]:
    """Yield the record of each place and kind of masks; those that are finished already are read from `work`.

    vectors: the folder that the words are from.
    """
    hashes = {path.name: hash_file(path) for path in sorted(vectors.iterdir()) if path.is_file()}
    code = stamp(CODE)  # once: of what is loaded, whatever becomes of the files meanwhile
    known = {"version": VERSION, "code": code, "vectors": hashes, "wrong": list(draws.wrong)}
    work.mkdir(parents=True, exist_ok=True)
    for one in given:
        for masks in MASKS[kind_of(one)]:
            start, place = time.perf_counter(), place_of(one, masks, kept)
            key = known | {"seeds": draws.seeds, "place": place.inputs}
            path = work / f"{place.inputs.partition('.')[0]}.{masks}.{len(words.words)}.json"
            record = _finished(path, key)
            if record is None:
                record = {"place": path.name.partition(".")[0], "kind": kind_of(one), "masks": masks}
                record |= {"words": len(words.words), **record_of(draws.of(place, words))}
                record |= {"code": code, "seconds": round(time.perf_counter() - start, 1)}
                with replacing(path, overwrite=True) as file:
                    file.write(json.dumps({"key": key, "record": record}).encode())
            yield record


def _finished(path: Path, key: dict[str, Any]) -> dict[str, Any] | None:
    document = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    record: dict[str, Any] | None = document.get("record") if document.get("key") == key else None
    return record
