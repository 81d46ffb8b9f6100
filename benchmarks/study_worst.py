"""The worst answers to words, each with its picture and its cause: scene, masks, encoder, threshold or objects.

    python benchmarks/study_worst.py PLACE... --clip FOLDER --kept FOLDER --output FOLDER [--count 10] [--wrong 20]
        [--records FILE.jsonl]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it; both with the
masks of `graph` and with the other kind (suite/answers.py). The worst are those with the lowest IoU of the default
answer, in whole objects, and of equal ones those with the most to gain from the best threshold: at most two of a place,
and no word twice there. The causes are measured (suite/causes.py), and counted for all answers below IoU 0.5. FOLDER
gets a picture of each: its outline in the photo (yellow), what is selected by default, and what the best threshold
selects. Where no photo has an outline of the thing, as where only things hidden by others are left, there is no
picture. --records: the worst of a run of study_rules.py, masks of `graph`, instead of asking everything again.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.study_rules import read
from benchmarks.suite.answers import MASKS, Answered, Draws, answered, best_cut, kind_of, place_of
from benchmarks.suite.causes import CAUSES, Culprits, Seen, Steps
from benchmarks.suite.places import Place
from benchmarks.suite.tables import markdown
from benchmarks.suite.trials import Trial, trial
from benchmarks.suite.vocabularies import KINDS, Clip
from drsplat import load_image
from drsplat.drawing.pictures import contact_sheet, highlighted, titled, write_picture

AT_MOST = 2  # of a place
BAD = 0.5  # IoU of the default answer
YELLOW = (255, 214, 0)


class Bad(NamedTuple):
    """place: as given. trial: its number among the draws of the place and these masks."""

    place: str
    masks: str
    trial: int
    name: str
    answer: Answered
    steps: Steps


def bad_answers(given: Sequence[str], clip: Clip, kept: Path, draws: Draws) -> Iterator[Bad]:
    for one in given:
        for masks in MASKS[kind_of(one)]:
            culprits = Culprits(place_of(one, masks, kept))
            for number, case in enumerate(draws.of(culprits.place, clip)):
                for answer in answered(case):
                    if answer.objects < BAD:
                        yield Bad(one, masks, number, case.name, answer, culprits.steps(case, answer))


def recorded(given: Sequence[str], file: Path, draws: Draws) -> Iterator[Bad]:
    """Yield the bad answers of a run of study_rules.py, with all steps at 0: nobody has measured them."""
    names = {f"{Path(one.partition('=')[0]).name}, graph": one for one in given}
    numbers = {key: number for number, key in enumerate(_keys(draws))}
    for done in read(file):
        place, words, *key = done["trial"]
        if place in names and words == Clip.__name__ and tuple(key) in numbers:
            for one in done["asked"]:
                if "iou" in one and one["iou"]["objects"] < BAD:
                    plain, objects, best = (one["iou"][name] for name in ("plain", "objects", "best threshold"))
                    answer = Answered(one["text"], plain, objects, best, False, False, False)
                    yield Bad(names[place], "graph", numbers[tuple(key)], place, answer, Steps(0, 0, 0, 0, 0))


def _keys(draws: Draws) -> list[tuple[str, int, int]]:
    """Return kind, percent of wrong masks and seed of each of the draws, in their order."""
    return list(product(KINDS, draws.wrong, range(draws.seeds)))


def case_of(bad: Bad, place: Place, clip: Clip, draws: Draws) -> Trial:
    kind, wrong, seed = _keys(draws)[bad.trial]
    return trial(place, clip, kind, wrong / 100, seed)


def census(found: Sequence[Bad]) -> str:
    """Count the causes of bad answers, by kind of place and masks."""
    kinds = dict.fromkeys((kind_of(bad.place), bad.masks) for bad in found)
    rows = []
    for kind in kinds:
        counts = Counter(bad.steps.cause for bad in found if (kind_of(bad.place), bad.masks) == kind)
        rows.append((f"{kind[0]}s, {kind[1]}", *(f"{counts[cause]}" for cause in CAUSES)))
    return markdown(("bad answers in", *CAUSES), rows)


def worst(found: Sequence[Bad], count: int) -> list[Bad]:
    chosen: list[Bad] = []
    for bad in sorted(found, key=lambda bad: (round(bad.answer.objects, 3), -bad.answer.best)):
        of_place = [other for other in chosen if other.place == bad.place]
        if len(of_place) < AT_MOST and bad.answer.text not in [other.answer.text for other in of_place]:
            chosen.append(bad)
    return chosen[:count]


def picture(culprits: Culprits, case: Trial, answer: Answered, steps: Steps, called: str) -> np.ndarray | None:
    """Three pictures side by side of the photo with the largest outline; None without one. called: what is meant."""
    seen = culprits.seen(culprits.things(case, answer.text))
    if not seen:
        return None
    plain, whole = (case.scene(objects=objects).ask(answer.text) for objects in (False, True))
    cut, _ = best_cut(plain.values, case.present[answer.text], case.mass)
    ids = case.field.gaussian_ids
    panels = [
        (None, f"“{answer.text}”", called),
        (ids[whole.values > whole.threshold], "default", f"IoU {answer.objects:.2f}"),
        (ids[plain.values >= cut], "best threshold", f"IoU {answer.best:.2f}"),
    ]
    parts = [titled(panel(culprits, seen[0], chosen), name, note) for chosen, name, note in panels]
    losses = ", ".join(f"{name} {loss:.2f}" for name, loss in steps.losses.items())
    sheet = contact_sheet(parts, 3, 420, 8)
    return titled(sheet, f"{steps.cause}: {culprits.place.name}", f"lost: {losses}")


def panel(culprits: Culprits, seen: Seen, ids: np.ndarray | None) -> np.ndarray:
    view = seen.view
    image = Image.fromarray(load_image(seen.stored)).resize((view.width, view.height), Image.Resampling.LANCZOS)
    photo = np.asarray(image)
    if ids is not None:
        photo = highlighted(photo, culprits.drawn(view, ids).astype(np.float32), 1)
    edge = ndimage.binary_dilation(seen.outline, iterations=2) & ~seen.outline
    photo = photo.copy()
    photo[edge] = YELLOW
    return photo


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--output", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--wrong", nargs="+", type=int, default=[20])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--records", type=Path, metavar="FILE.jsonl")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    clip, draws = Clip(arguments.clip), Draws(tuple(arguments.wrong), arguments.seeds)
    records = arguments.records
    found = list(
        recorded(arguments.places, records, draws)
        if records
        else bad_answers(arguments.places, clip, arguments.kept, draws)
    )
    print("| answer | cause | true Gaussians | masks | best threshold | plain | objects |\n|---|---|" + "--:|" * 5)
    for number, bad in enumerate(worst(found, arguments.count)):
        culprits = Culprits(place_of(bad.place, bad.masks, arguments.kept))
        case = case_of(bad, culprits.place, clip, draws)
        bad = bad._replace(steps=culprits.steps(case, bad.answer), name=case.name) if records else bad
        meant = set(culprits.things(case, bad.answer.text).tolist())
        called = ", ".join(name for name, ids in culprits.place.things.items() if meant & set(ids))
        numbers = " | ".join(f"{value:.2f}" for value in bad.steps)
        print(f"| {bad.name}: {called}, called “{bad.answer.text}” | {bad.steps.cause} | {numbers} |", flush=True)
        sheet = picture(culprits, case, bad.answer, bad.steps, called)
        if sheet is not None:
            path = arguments.output / f"{number:02d}_{culprits.place.name.replace(', ', '_')}.jpg"
            write_picture(path, sheet, overwrite=True)
    if not records:
        print(f"\n{census(found)}")


if __name__ == "__main__":
    main()
