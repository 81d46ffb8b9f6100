"""Whether objects help: answers of the plain field and of objects, side by side, in made rooms and real captures.

    python benchmarks/study_answers.py PLACE... --clip FOLDER --kept FOLDER [--wrong 0 20 40] [--seeds 2]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it. Words and
embeddings are drawn as `suite/trials.py` says, of things that are known by `suite/places.py`. IoU is over Gaussians, by
the weight that photos give them in which the truth is known. Columns: the plain field, objects, and the best threshold
of the plain field; how many present words find nothing, and how many absent ones find something.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite import places
from benchmarks.suite.trials import KINDS, Clip, Trial, trial
from drsplat.query.defaults import MIN_GAUSSIANS

OUTLINES = Path(__file__).resolve().parent.parent / "tests"
MASKS = {"room": ("graph", "true"), "capture": ("graph", "sam")}


class Scores(NamedTuple):
    """Lists over queries: IoU of the plain field, with objects, at the best threshold; then 0 or 1."""

    plain: list[float]
    objects: list[float]
    best: list[float]
    missed_plain: list[float]
    missed_objects: list[float]
    found_plain: list[float]
    found_objects: list[float]


def scored(case: Trial) -> Scores:
    scores = Scores(*([] for _ in Scores._fields))
    plain, whole = case.scene(objects=False), case.scene(objects=True)
    for text, meant in case.present.items():
        answers = plain.ask(text), whole.ask(text)
        selected = [answer.values > answer.threshold for answer in answers]
        for ious, missed, some in zip(scores[:2], scores[3:5], selected, strict=True):
            ious.append(case.iou(some, meant))
            missed.append(float(some.sum() < MIN_GAUSSIANS))
        scores.best.append(best_iou(answers[0].values, meant, case.mass))
    for text in case.absent:
        for found, scene in zip(scores[5:], (plain, whole), strict=True):
            answer = scene.ask(text)
            found.append(float((answer.values > answer.threshold).sum() >= MIN_GAUSSIANS))
    return scores


def best_iou(values: np.ndarray, meant: np.ndarray, mass: np.ndarray) -> float:
    """Of all thresholds on the values."""
    order = np.argsort(-values, kind="stable")
    hits, taken = np.cumsum((mass * meant)[order]), np.cumsum(mass[order])
    return float((hits / np.maximum(taken + (mass * meant).sum() - hits, 1e-9)).max())


def places_of(given: str, kept: Path) -> Iterator[places.Place]:
    folder, _, scene = given.partition("=")
    for kind in MASKS["capture" if scene else "room"]:
        if scene:
            outlines = OUTLINES / f"{Path(folder).name}_outlines.json"
            known = outlines if outlines.is_file() else None
            yield places.capture(Path(folder), Path(scene), known, kind, kept)
        else:
            yield places.room(Path(folder), kind, kept)


def trials_of(place: places.Place, clip: Clip, wrong: list[int], seeds: int) -> Iterator[Trial]:
    for kind in KINDS:
        for share in wrong:
            for seed in range(seeds):
                yield trial(place, clip, kind, share / 100, seed, range(seed % 2, len(clip.words), 2))


def said(values: list[float]) -> str:
    """Mean, and half of a 95 % interval over queries."""
    return f"{np.mean(values):.3f} ± {1.96 * np.std(values) / np.sqrt(len(values)):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20, 40])
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    clip = Clip(arguments.clip)
    print("| place | plain | objects | best threshold | missed | absent found |\n" + "|---" * 6 + "|")
    for given in arguments.places:
        for place in places_of(given, arguments.kept):
            some = [scored(case) for case in trials_of(place, clip, arguments.wrong, arguments.seeds)]
            pooled = Scores(*([value for scores in some for value in scores[at]] for at in range(len(Scores._fields))))
            print(
                f"| {place.name} | {said(pooled.plain)} | {said(pooled.objects)} | {said(pooled.best)} "
                f"| {np.mean(pooled.missed_plain):.0%}, {np.mean(pooled.missed_objects):.0%} "
                f"| {np.mean(pooled.found_plain):.0%}, {np.mean(pooled.found_objects):.0%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
