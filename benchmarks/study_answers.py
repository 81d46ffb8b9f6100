"""Whether objects help: answers of the plain field and of objects, side by side, in made rooms and real captures.

    python benchmarks/study_answers.py PLACE... --kept FOLDER [--clip FOLDER] [--names FOLDER] [--wrong 0 20 40]
        [--seeds 2]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it. --clip and
--names: vectors of 40 words and genuine centroids, and of the 1,203 names of LVIS (`suite/vocabularies.py`). Trials are
drawn as `suite/trials.py` says, of things known by `suite/places.py`. IoU is over Gaussians, by the weight that
photos give them in which the truth is known. Columns: the plain field, objects, and the best threshold of the plain
field, of all things and of those of less than 1 % of the Gaussians; how many present words find nothing, and how many
absent ones find something.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite import places
from benchmarks.suite.trials import Trial, trial
from benchmarks.suite.vocabularies import KINDS, Clip, Names, Vocabulary
from drsplat.query.defaults import MIN_GAUSSIANS

OUTLINES = Path(__file__).resolve().parent.parent / "tests"
MASKS = {"room": ("graph", "true"), "capture": ("graph", "sam")}
SMALL = 0.01  # of the Gaussians


class Scores(NamedTuple):
    """Lists over queries: IoU of the plain field, with objects, at the best threshold; then 0 or 1.

    small: whether the thing has less than SMALL of the Gaussians.
    """

    plain: list[float]
    objects: list[float]
    best: list[float]
    missed_plain: list[float]
    missed_objects: list[float]
    found_plain: list[float]
    found_objects: list[float]
    small: list[float]


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
        scores.small.append(float(meant.mean() < SMALL))
    for text in case.absent:
        for found, scene in zip(scores[5:7], (plain, whole), strict=True):
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


def trials_of(place: places.Place, words: Vocabulary, wrong: list[int], seeds: int) -> Iterator[Trial]:
    for kind in KINDS:
        for share in wrong:
            for seed in range(seeds):
                yield trial(place, words, kind, share / 100, seed)


def said(values: list[float]) -> str:
    """Mean, and half of a 95 % interval over queries."""
    return f"{np.mean(values):.3f} ± {1.96 * np.std(values) / np.sqrt(len(values)):.3f}"


def row(name: str, scores: list[Scores]) -> str:
    """Return a row of the table, of all trials of a place."""
    pooled = Scores(*([value for some in scores for value in some[at]] for at in range(len(Scores._fields))))
    small = np.array(pooled.small, bool)
    few = [float(np.mean(np.array(ious)[small])) if small.any() else float("nan") for ious in pooled[:3]]
    return (
        f"| {name} | {said(pooled.plain)} | {said(pooled.objects)} | {said(pooled.best)} "
        f"| {few[0]:.3f}, {few[1]:.3f}, {few[2]:.3f} "
        f"| {np.mean(pooled.missed_plain):.0%}, {np.mean(pooled.missed_objects):.0%} "
        f"| {np.mean(pooled.found_plain):.0%}, {np.mean(pooled.found_objects):.0%} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--names", type=Path)
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20, 40])
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    folders = {"40 words": (Clip, arguments.clip), "1,203 names": (Names, arguments.names)}
    vocabularies: dict[str, Vocabulary] = {name: make(folder) for name, (make, folder) in folders.items() if folder}
    if not vocabularies:
        parser.error("expected --clip FOLDER or --names FOLDER: without vectors of words nothing can be asked")
    print("| place | plain | objects | best threshold | small things | missed | absent found |\n" + "|---" * 7 + "|")
    for given in arguments.places:
        for place in places_of(given, arguments.kept):
            for title, words in vocabularies.items():
                scores = [scored(case) for case in trials_of(place, words, arguments.wrong, arguments.seeds)]
                print(row(f"{place.name}, {title}", scores), flush=True)


if __name__ == "__main__":
    main()
