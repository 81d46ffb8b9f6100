"""What a better cut of the answers could gain, beside what refusing words costs.

    python benchmarks/study_cuts.py CAPTURE=SCENE... ROOM... [--clip FOLDER | --names FOLDER] --kept FOLDER

Places, words and draws are those of `study_answers.py`, one draw of each kind with a fifth of the masks wrong; words
that something is called by. IoU with objects: "rule", as drsplat answers; "no refusal", the same cut where no word is
taken for absent, so that all words that are not there are found too; "cut", the best share of the way to the peak in
place of the rule's (`query/contrast.py::OWN_THRESHOLD_SHARE`), chosen with the truth for each place; "best", the best
threshold of the plain field for each word. The last line has means of shares of the last one, and the best share for
all places.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import Draws, best_iou, places_of
from benchmarks.suite.places import Place
from benchmarks.suite.vocabularies import Clip, Names, Vocabulary
from drsplat.query.contrast import OWN_THRESHOLD_SHARE, own_level

SHARES = np.round(np.arange(0, 1.01, 0.05), 2)
DRAWS = Draws((20,), 1)


def measured(place: Place, words: Vocabulary) -> dict[str, np.ndarray]:
    """Return the IoU of each word: of the rule, of each of SHARES without refusal (a row each), and of the best."""
    rule, best, shares = [], [], []
    for case in DRAWS.of(place, words):
        plain, objects = case.scene(objects=False), case.scene(objects=True)
        for text, meant in case.present.items():
            own, answer = plain.ask(text).values, objects.ask(text)
            known = plain.background.contrast_for(text)
            assert known is not None
            cut = own_level(own, known.peak)
            margin = np.log(cut / (1 - cut)) / OWN_THRESHOLD_SHARE
            rule.append(case.iou(answer.values > answer.threshold, meant))
            best.append(best_iou(own, meant, case.mass))
            shares.append([case.iou(answer.values > 1 / (1 + np.exp(-share * margin)), meant) for share in SHARES])
    return {"rule": np.array(rule), "best": np.array(best), "shares": np.array(shares).T}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--clip", type=Path)
    which.add_argument("--names", type=Path)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    arguments = parser.parse_args()
    words = Clip(arguments.clip) if arguments.clip else Names(arguments.names)
    own, found = int(np.abs(SHARES - OWN_THRESHOLD_SHARE).argmin()), []
    print("| place | rule | no refusal | cut | best |\n|---|--:|--:|--:|--:|")
    for given in arguments.places:
        for place in places_of(given, arguments.kept):
            one = measured(place, words)
            means, best = one["shares"].mean(1), one["best"].mean()
            found.append(np.array([one["rule"].mean(), *means]) / best)
            print(f"| {place.name} | {one['rule'].mean():.3f} | {means[own]:.3f} | {means.max():.3f} | {best:.3f} |")
    rule, *shares = np.mean(found, axis=0)
    each = np.mean([place[1:].max() for place in found])
    print(f"| of the best | {rule:.3f} | {shares[own]:.3f} | {each:.3f} | 1 |")
    print(f"\none share for all: {SHARES[int(np.argmax(shares))]:.2f}, {max(shares):.3f} of the best")


if __name__ == "__main__":
    main()
